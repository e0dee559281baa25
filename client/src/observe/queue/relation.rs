//! The relation of the numbers of the queue to the sequence numbers of the daemon: sequence = number + offset.
//!
//! Invariant: pure. A record that the daemon may have keeps its sequence number; a record that the daemon cannot have
//! never gets the sequence number of another record.

/// The state of a queue beside its records.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct QueueRelation {
    /// Sequence number of the daemon minus the number of the record; `None`: the daemon was never reached.
    #[prost(sint64, optional, tag = "1")]
    pub(super) offset: Option<i64>,
    /// Number of the next record.
    #[prost(uint64, tag = "2")]
    pub(super) next: u64,
    /// Number of the last record that was found at the start; `None` once the daemon was reached.
    #[prost(uint64, optional, tag = "3")]
    pub(super) recovered: Option<u64>,
    /// Records that the daemon had acknowledged and no longer has: a backup was restored.
    #[prost(uint64, tag = "4")]
    pub(super) lost: u64,
    /// The daemon has acknowledged the records up to this one, or more.
    #[prost(uint64, tag = "5")]
    pub(super) acknowledged: u64,
    /// The map, producer and label of the queue.
    #[prost(string, tag = "6")]
    pub(super) map: String,
    #[prost(string, tag = "7")]
    pub(super) producer: String,
    #[prost(string, tag = "8")]
    pub(super) label: String,
}

impl QueueRelation {
    /// A folder was opened that keeps the records before `next`. A start that never reached the daemon has added
    /// records; the state that the first such start found counts.
    pub(super) fn opened(&mut self, next: u64) {
        self.next = next;
        self.recovered = Some(self.recovered.map_or(next - 1, |recovered| recovered.min(next - 1)));
    }

    /// The daemon has everything of this producer up to a sequence number; `first` is the number of the oldest record
    /// that is kept, or of the next one. Returns the number up to which the daemon has the records.
    pub(super) fn linked(&mut self, durable_sequence: u64, first: u64) -> u64 {
        // After a power cut the daemon may have records that this disk has lost. Records that were appended since have
        // their numbers, but other content.
        let last = self.recovered.take().unwrap_or(self.next - 1);
        let durable = signed(durable_sequence);
        let before = signed(first - 1);
        match self.offset {
            // Nothing was sent from this folder: the daemon's data comes from another folder of this producer.
            None => self.offset = Some(durable - before),
            Some(offset) if durable < before.saturating_add(offset) => {
                self.lost += before.saturating_add(offset).abs_diff(durable);
                self.offset = Some(durable - before);
            }
            // This folder is older than the data that was sent, for example a copy: new records come behind.
            Some(offset) if durable > signed(last).saturating_add(offset) => self.offset = Some(durable - signed(last)),
            Some(_) => {}
        }
        self.acknowledged = self.number(durable_sequence);
        self.acknowledged
    }

    /// The number of the record that has a sequence number; 0: a record before the first one.
    pub(super) fn number(&self, sequence: u64) -> u64 {
        let number = i128::from(sequence) - i128::from(self.offset.unwrap_or(0));
        u64::try_from(number.max(0)).unwrap_or(u64::MAX)
    }

    /// The sequence number of a record.
    pub(super) fn sequence(&self, number: u64) -> i128 {
        i128::from(number) + i128::from(self.offset.unwrap_or(0))
    }
}

fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relation(offset: Option<i64>, next: u64, recovered: Option<u64>) -> QueueRelation {
        QueueRelation { offset, next, recovered, ..QueueRelation::default() }
    }

    #[test]
    fn a_fresh_queue_continues_behind_the_data_of_the_daemon() {
        let mut fresh = relation(None, 2, Some(1));
        assert_eq!((fresh.linked(500, 1), fresh.offset, fresh.lost), (0, Some(500), 0));
        assert_eq!((fresh.sequence(1), fresh.number(501)), (501, 1));
        // The record was sent as 501, and the daemon has it.
        assert_eq!((fresh.linked(501, 1), fresh.offset), (1, Some(500)));
    }

    #[test]
    fn a_restored_backup_is_counted_and_the_rest_is_sent_behind_it() {
        let mut restored = relation(Some(0), 13, None);
        assert_eq!((restored.linked(3, 7), restored.lost), (6, 3));
        assert_eq!(restored.sequence(7), 4);
    }

    #[test]
    fn a_backup_that_has_all_records_before_the_kept_ones_loses_nothing() {
        let mut restored = relation(Some(0), 13, None);
        assert_eq!((restored.linked(6, 7), restored.lost, restored.offset), (6, 0, Some(0)));
        assert_eq!((restored.linked(9, 7), restored.lost, restored.offset), (9, 0, Some(0)));
    }

    #[test]
    fn a_copy_of_an_older_folder_does_not_use_numbers_twice() {
        let mut copy = relation(Some(0), 2, Some(1));
        assert_eq!((copy.linked(9, 1), copy.sequence(2)), (1, 10));
    }

    #[test]
    fn records_that_a_power_cut_took_do_not_hide_new_ones() {
        // The daemon has three records; two were found, and a third was appended by a start that never connected.
        let mut cut = relation(Some(0), 3, None);
        cut.opened(3);
        cut.next = 4;
        cut.opened(4);
        assert_eq!((cut.recovered, cut.linked(3, 1), cut.sequence(3)), (Some(2), 2, 4));
        // The state stays so.
        cut.opened(4);
        assert_eq!((cut.linked(3, 1), cut.sequence(3)), (2, 4));
    }

    #[test]
    fn a_record_in_flight_that_arrived_is_not_sent_again() {
        let mut known = relation(Some(20), 11, None);
        known.opened(11);
        assert_eq!((known.linked(25, 1), known.offset, known.lost), (5, Some(20), 0));
    }

    #[test]
    fn a_map_that_was_created_again_begins_anew() {
        let mut anew = relation(Some(0), 101, None);
        assert_eq!((anew.linked(0, 81), anew.lost, anew.sequence(81)), (80, 80, 1));
    }
}
