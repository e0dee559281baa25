//! The lists of files and maps that must exist, as text: a first line with the kind of the list, a line for each entry,
//! and a checksum of all lines before it.
//!
//! Invariant: writing the content of a text that was read gives the text again.

/// File of [`MapList`] in the data directory.
pub const MAPS_FILE: &str = "MAPS";
/// File of [`FileList`] in the folder of a map.
pub const HISTORY_FILE: &str = "HISTORY";
/// File of [`NewestSegment`] in the folder of a log.
pub const NEWEST_FILE: &str = "NEWEST";
/// File of [`ErasureOrder`] in the folder of a map.
pub const ERASE_FILE: &str = "ERASE";
/// File of [`ErasureCount`] in the folder of a map.
pub const ERASURES_FILE: &str = "ERASURES";
/// File of [`CheckpointList`] in the folder of a map.
pub const CHECKPOINTS_FILE: &str = "CHECKPOINTS";
/// File of [`LossList`] in the data directory.
pub const LOSSES_FILE: &str = "LOSSES";

/// The maps of a data directory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapList {
    /// The next number for a map; numbers are never used again.
    pub next: u32,
    /// Number and name of each map, ascending by number.
    pub maps: Vec<(u32, String)>,
}

/// The history files of a map.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FileList {
    /// The files, ascending by name.
    pub files: Vec<ListedFile>,
}

/// A history file that must exist.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ListedFile {
    /// Name of the file in the folder `history`.
    pub name: String,
    /// The smallest time of its observations.
    pub from_nanos: i64,
    /// The greatest time of its observations.
    pub to_nanos: i64,
    /// Length of the file in bytes.
    pub length: u64,
    /// The checksum in its trailer.
    pub total_crc: u32,
}

/// The newest segment of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewestSegment {
    /// Log position of the first record of the segment.
    pub first_position: u64,
}

/// The observations to erase from a map. The file exists until they are erased.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ErasureOrder {
    /// Ids of states, ascending; if `part` is given, an empty list means all states.
    pub states: Vec<u32>,
    /// The part of the observations of these states; `None`: all observations, and the states themselves.
    pub part: Option<ErasedPart>,
}

/// Some of the observations of states.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ErasedPart {
    /// The first time, nanoseconds UTC.
    pub from_nanos: i64,
    /// The time before which the observations lie, nanoseconds UTC; the greatest i64: all later observations.
    pub to_nanos: i64,
    /// Ids of producers, ascending; an empty list means all producers.
    pub producers: Vec<u32>,
    /// Whether the sequences of these producers are forgotten, and states without remaining observations stay.
    pub forgets: bool,
}

/// The number of erasures in a map; there is no file before the first one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErasureCount {
    /// Number of erasures.
    pub count: u64,
}

/// The checkpoints of a map, and the begin of its log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckpointList {
    /// The record with which the first segment of the log begins; an earlier segment may still exist.
    pub first_record: u64,
    /// Log positions of the checkpoints that must exist, ascending; a further checkpoint may exist.
    pub checkpoints: Vec<u64>,
}

impl Default for CheckpointList {
    /// Returns the list of a new map.
    fn default() -> CheckpointList {
        CheckpointList { first_record: 1, checkpoints: Vec::new() }
    }
}

/// The losses that were accepted, in the order of their acceptance.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LossList {
    /// The losses.
    pub losses: Vec<Loss>,
}

/// Something that is lost, and accepted as lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Time at which an operator accepted the loss, nanoseconds UTC.
    pub accepted_nanos: i64,
    /// The file or folder, within the data directory; without spaces.
    pub file: String,
    /// Description of the damage; one line.
    pub problem: String,
}

/// A list that is stored as text.
pub trait TextList: Sized {
    /// The first line of the file, which names the list and its version.
    const FIRST_LINE: &'static str;
    /// The lines between the first and the checksum.
    fn lines(&self) -> Vec<String>;
    /// The list of these lines; `None` if a line is not valid.
    fn parse(lines: &[&str]) -> Option<Self>;

    /// The text of the file.
    fn to_text(&self) -> String {
        let mut text = format!("{}\n", Self::FIRST_LINE);
        for line in self.lines() {
            text.push_str(&line);
            text.push('\n');
        }
        let checksum = crc32c::crc32c(text.as_bytes());
        text + &format!("crc32c {checksum:08x}\n")
    }

    /// Reads the list from a text.
    ///
    /// # Errors
    /// Returns a description of the fault if the text is not valid.
    fn from_text(text: &[u8]) -> Result<Self, &'static str> {
        let text = std::str::from_utf8(text).map_err(|_| "it is not text")?;
        let body = text.rfind("crc32c ").and_then(|end| text.get(..end)).ok_or("its checksum is missing")?;
        let mut lines = body.lines();
        if lines.next() != Some(Self::FIRST_LINE) {
            return Err("its first line is not valid");
        }
        let list = Self::parse(&lines.collect::<Vec<_>>()).ok_or("a line is not valid")?;
        // Writing the list again must give the same bytes, with the same checksum.
        if list.to_text() == text { Ok(list) } else { Err("its checksum does not match") }
    }
}

impl TextList for MapList {
    const FIRST_LINE: &'static str = "tidemap maps";

    fn lines(&self) -> Vec<String> {
        let maps = self.maps.iter().map(|(map, name)| format!("map {map} {name}"));
        std::iter::once(format!("next {}", self.next)).chain(maps).collect()
    }

    fn parse(lines: &[&str]) -> Option<MapList> {
        let (next, maps) = lines.split_first()?;
        let map = |line: &&str| {
            let (number, name) = line.strip_prefix("map ")?.split_once(' ')?;
            Some((number.parse().ok()?, name.to_owned()))
        };
        let maps = maps.iter().map(map).collect::<Option<_>>()?;
        Some(MapList { next: next.strip_prefix("next ")?.parse().ok()?, maps })
    }
}

impl TextList for FileList {
    const FIRST_LINE: &'static str = "tidemap history";

    fn lines(&self) -> Vec<String> {
        let line = |file: &ListedFile| {
            let ListedFile { name, from_nanos, to_nanos, length, total_crc } = file;
            format!("file {name} {from_nanos} {to_nanos} {length} {total_crc:08x}")
        };
        self.files.iter().map(line).collect()
    }

    fn parse(lines: &[&str]) -> Option<FileList> {
        let file = |line: &&str| {
            let mut fields = line.strip_prefix("file ")?.split(' ');
            let file = ListedFile {
                name: fields.next()?.to_owned(),
                from_nanos: fields.next()?.parse().ok()?,
                to_nanos: fields.next()?.parse().ok()?,
                length: fields.next()?.parse().ok()?,
                total_crc: u32::from_str_radix(fields.next()?, 16).ok()?,
            };
            fields.next().is_none().then_some(file)
        };
        Some(FileList { files: lines.iter().map(file).collect::<Option<_>>()? })
    }
}

impl TextList for NewestSegment {
    const FIRST_LINE: &'static str = "tidemap log";

    fn lines(&self) -> Vec<String> {
        vec![format!("newest {}", self.first_position)]
    }

    fn parse(lines: &[&str]) -> Option<NewestSegment> {
        let [line] = lines else { return None };
        Some(NewestSegment { first_position: line.strip_prefix("newest ")?.parse().ok()? })
    }
}

impl TextList for ErasureOrder {
    const FIRST_LINE: &'static str = "tidemap erasure";

    fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self.states.iter().map(|state| format!("state {state}")).collect();
        if let Some(part) = &self.part {
            lines.push(format!("from {}", part.from_nanos));
            lines.push(format!("to {}", part.to_nanos));
            lines.extend(part.producers.iter().map(|producer| format!("producer {producer}")));
            if part.forgets {
                lines.push("forget".to_owned());
            }
        }
        lines
    }

    fn parse(lines: &[&str]) -> Option<ErasureOrder> {
        let (states, rest) = lines.split_at(lines.iter().take_while(|line| line.starts_with("state ")).count());
        let states = states.iter().map(|line| line.strip_prefix("state ")?.parse().ok()).collect::<Option<_>>()?;
        let [from, to, rest @ ..] = rest else { return rest.is_empty().then_some(ErasureOrder { states, part: None }) };
        let (forget, producers) = match rest.split_last() {
            Some((&"forget", producers)) => (true, producers),
            _ => (false, rest),
        };
        let producer = |line: &&str| line.strip_prefix("producer ")?.parse().ok();
        let part = ErasedPart {
            from_nanos: from.strip_prefix("from ")?.parse().ok()?,
            to_nanos: to.strip_prefix("to ")?.parse().ok()?,
            producers: producers.iter().map(producer).collect::<Option<_>>()?,
            forgets: forget,
        };
        Some(ErasureOrder { states, part: Some(part) })
    }
}

impl TextList for ErasureCount {
    const FIRST_LINE: &'static str = "tidemap erasures";

    fn lines(&self) -> Vec<String> {
        vec![format!("count {}", self.count)]
    }

    fn parse(lines: &[&str]) -> Option<ErasureCount> {
        let [line] = lines else { return None };
        Some(ErasureCount { count: line.strip_prefix("count ")?.parse().ok()? })
    }
}

impl TextList for CheckpointList {
    const FIRST_LINE: &'static str = "tidemap checkpoints";

    fn lines(&self) -> Vec<String> {
        let checkpoints = self.checkpoints.iter().map(|position| format!("checkpoint {position}"));
        std::iter::once(format!("first {}", self.first_record)).chain(checkpoints).collect()
    }

    fn parse(lines: &[&str]) -> Option<CheckpointList> {
        let (first, checkpoints) = lines.split_first()?;
        let position = |line: &&str| line.strip_prefix("checkpoint ")?.parse().ok();
        let checkpoints = checkpoints.iter().map(position).collect::<Option<_>>()?;
        Some(CheckpointList { first_record: first.strip_prefix("first ")?.parse().ok()?, checkpoints })
    }
}

impl TextList for LossList {
    const FIRST_LINE: &'static str = "tidemap losses";

    fn lines(&self) -> Vec<String> {
        let line = |loss: &Loss| format!("loss {} {} {}", loss.accepted_nanos, loss.file, loss.problem);
        self.losses.iter().map(line).collect()
    }

    fn parse(lines: &[&str]) -> Option<LossList> {
        let loss = |line: &&str| {
            let mut fields = line.strip_prefix("loss ")?.splitn(3, ' ');
            let accepted_nanos = fields.next()?.parse().ok()?;
            let [file, problem] = [fields.next()?, fields.next()?].map(str::to_owned);
            Some(Loss { accepted_nanos, file, problem })
        };
        Some(LossList { losses: lines.iter().map(loss).collect::<Option<_>>()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that a list is read as it was written, and that a text with a flipped bit or a cut text is refused.
    fn check<L: TextList + PartialEq + std::fmt::Debug>(list: &L) {
        let text = list.to_text().into_bytes();
        assert_eq!(L::from_text(&text).as_ref(), Ok(list));
        for bit in 0..text.len() * 8 {
            let mut bad = text.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(L::from_text(&bad).is_err(), "bit {bit}");
        }
        for length in 0..text.len() {
            assert!(L::from_text(&text[..length]).is_err(), "length {length}");
        }
    }

    #[test]
    fn what_is_written_is_read_and_every_change_is_noticed() {
        check(&MapList { next: 4, maps: vec![(1, "office".to_owned()), (3, "crc32c 1".to_owned())] });
        let name = "00000000000000000007.states.tmh".to_owned();
        check(&FileList { files: vec![ListedFile { name, from_nanos: -5, to_nanos: 9, length: 77, total_crc: 12 }] });
        check(&FileList::default());
        check(&NewestSegment { first_position: 101 });
        check(&ErasureOrder { states: vec![3, 4, 17], part: None });
        let part = ErasedPart { from_nanos: -5, to_nanos: i64::MAX, producers: vec![2, 11], forgets: true };
        check(&ErasureOrder { states: vec![3], part: Some(part) });
        check(&ErasureOrder { states: Vec::new(), part: Some(ErasedPart::default()) });
        check(&ErasureCount { count: 2 });
    }

    #[test]
    fn the_lists_are_written_like_this_for_ever() {
        let maps = MapList { next: 2, maps: vec![(1, "office".to_owned())] };
        assert!(maps.to_text().starts_with("tidemap maps\nnext 2\nmap 1 office\ncrc32c "));
        let newest = NewestSegment { first_position: 101 };
        assert!(newest.to_text().starts_with("tidemap log\nnewest 101\ncrc32c "));
        let order = ErasureOrder { states: vec![3, 4], part: None };
        assert!(order.to_text().starts_with("tidemap erasure\nstate 3\nstate 4\ncrc32c "));
        let part = ErasedPart { from_nanos: 7, to_nanos: 9, producers: vec![1], forgets: true };
        let order = ErasureOrder { states: vec![3], part: Some(part) };
        let text = "tidemap erasure\nstate 3\nfrom 7\nto 9\nproducer 1\nforget\ncrc32c ";
        assert!(order.to_text().starts_with(text));
        assert!(ErasureCount { count: 2 }.to_text().starts_with("tidemap erasures\ncount 2\ncrc32c "));
    }

    #[test]
    fn the_lists_of_checkpoints_and_losses_are_read_as_written_and_written_like_this_for_ever() {
        let list = CheckpointList { first_record: 101, checkpoints: vec![120, 140] };
        check(&list);
        check(&CheckpointList::default());
        let text = "tidemap checkpoints\nfirst 101\ncheckpoint 120\ncheckpoint 140\ncrc32c ";
        assert!(list.to_text().starts_with(text));
        let file = "maps/00000001/HISTORY".to_owned();
        let loss = Loss { accepted_nanos: 5, file, problem: "it is missing".to_owned() };
        let list = LossList { losses: vec![loss.clone(), Loss { accepted_nanos: -7, ..loss }] };
        check(&list);
        assert!(list.to_text().starts_with("tidemap losses\nloss 5 maps/00000001/HISTORY it is missing\nloss -7 "));
    }
}
