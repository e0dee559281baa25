//! Files with common layouts and errors.

use super::*;

fn read(text: &[u8]) -> Result<Vec<RowItem>, RowError> {
    let mut rows = RowReader::new(text)?;
    let mut items = Vec::new();
    while let Some(item) = rows.next_item()? {
        items.push(item);
    }
    Ok(items)
}

fn good(items: &[RowItem]) -> Vec<(u64, u64, &str, i64, f64)> {
    items
        .iter()
        .filter_map(|item| match item {
            RowItem::Row(row) if row.wrong.is_none() => {
                Some((row.number, row.line, row.state.as_str(), row.time_nanos, row.value))
            }
            _ => None,
        })
        .collect()
}

fn wrong(line: &str) -> Result<ObservationRow, RowError> {
    let items = read(format!("time,state,value\n{line}\n").as_bytes())?;
    match items.as_slice() {
        [RowItem::Row(row)] => Ok(row.clone()),
        other => panic!("{other:?}"),
    }
}

const SECOND: i64 = 1_000_000_000;

#[test]
fn rows_are_read_in_any_order_of_columns_and_with_any_line_end() -> Result<(), RowError> {
    for text in [
        "time,state,value\n1,door,0\n2,door,0.5\n",
        "time,state,value\r\n1,door,0\r\n2,door,0.5\r\n",
        "\u{feff}time,state,value\n1,door,0\n2,door,0.5",
        "Value, State, Time\n0,door,1\n.5,\"door\",2\n",
        "note,time,state,value\nx,1,door,-0\n\"y,z\",2,door,5e-1\n",
    ] {
        let items = read(text.as_bytes())?;
        assert_eq!(good(&items), [(1, 2, "door", SECOND, 0.0), (2, 3, "door", 2 * SECOND, 0.5)], "{text:?}");
        assert!(matches!(&items[0], RowItem::Row(row) if row.value.is_sign_positive()), "{text:?}");
    }
    Ok(())
}

#[test]
fn blank_lines_do_not_count_as_rows() -> Result<(), RowError> {
    let items = read(b"time,state,value\n\n1,a,0\n  \n\r\n2,a,1\n\n")?;
    assert_eq!(good(&items), [(1, 3, "a", SECOND, 0.0), (2, 6, "a", 2 * SECOND, 1.0)]);
    Ok(())
}

#[test]
fn a_header_that_does_not_fit_is_shown() {
    let message = |text: &str| read(text.as_bytes()).err().map(|error| error.to_string()).unwrap_or_default();
    assert_eq!(message(""), "it is empty: the first line must be the header time,state,value");
    assert_eq!(
        message("1458518400,door,0\n"),
        "column \"time\" is missing: the header must name time, state and value, but is \"1458518400,door,0\""
    );
    assert!(message("time;state;value\n1;a;0\n").contains("time;state;value"));
    assert!(message("time,name,value\n").starts_with("column \"state\" is missing"));
    assert!(message("time,state,value,time\n").starts_with("column \"time\" appears twice"));
}

#[test]
fn columns_that_are_not_used_are_known() -> Result<(), RowError> {
    let rows = RowReader::new(b"time,robot,state,value,note\n".as_slice())?;
    assert_eq!(rows.ignored(), ["robot", "note"]);
    Ok(())
}

#[test]
fn what_cannot_be_read_uses_up_its_number_and_gives_the_reason() -> Result<(), RowError> {
    for (line, state, time_nanos, reason) in [
        ("soon,door,0", "door", 0, "time \"soon\" is not a time"),
        ("-5,door,0", "door", 0, "time \"-5\" is before 1970"),
        ("1,door,ajar", "door", SECOND, "value \"ajar\" is not a number"),
        ("1,door,", "door", SECOND, "value \"\" means that there is no value"),
        ("1,door", "", 0, "\"1,door\" has 2 fields, the header has 3"),
        ("1,door,0,5", "", 0, "\"1,door,0,5\" has 4 fields, the header has 3"),
        ("1,\"door,0", "", 0, "\"1,\\\"door,0\": a quote is not closed"),
    ] {
        let row = wrong(line)?;
        assert_eq!((row.number, row.line, row.state.as_str(), row.time_nanos), (1, 2, state, time_nanos), "{line}");
        assert!(row.value.is_nan(), "{line}");
        assert!(row.wrong.as_ref().is_some_and(|wrong| wrong.starts_with(reason)), "{:?}", row.wrong);
    }
    let long = wrong(&format!("1,{},0", "x".repeat(129)))?;
    assert!(long.state.is_empty() && long.wrong.is_some_and(|wrong| wrong.contains("129 characters")));
    let endless = wrong(&"x".repeat(LINE_BYTES_MAX + 1))?;
    assert!(endless.wrong.is_some_and(|wrong| wrong.contains("longer than 65536")));
    Ok(())
}

#[test]
fn values_out_of_range_are_wrong_but_sent_as_they_are() -> Result<(), RowError> {
    for text in ["2", "-1", "inf", "-inf", "NaN", "1e300", "1.0000001"] {
        let row = wrong(&format!("1,door,{text}"))?;
        assert_eq!(row.wrong, Some(format!("value {text} is not between 0 and 1")));
        assert_eq!(Ok(row.value.to_bits()), text.parse().map(f64::to_bits), "{text}");
    }
    for text in ["0", "-0", "1", "0.5", "1e-300"] {
        assert_eq!(wrong(&format!("1,door,{text}"))?.wrong, None, "{text}");
    }
    Ok(())
}

#[test]
fn bytes_that_are_not_text_spoil_one_row() -> Result<(), RowError> {
    let items = read(b"time,state,value\n1,d\xffr,0\n2,a,1\n")?;
    assert!(matches!(&items[0], RowItem::Row(row) if row.wrong.as_ref().is_some_and(|w| w.ends_with("is not UTF-8"))));
    assert_eq!(good(&items), [(2, 3, "a", 2 * SECOND, 1.0)]);
    Ok(())
}

#[test]
fn a_last_line_that_is_cut_off_is_no_row_until_it_is_whole() -> Result<(), RowError> {
    let whole = "time,state,value\n1,a,0\n2,kitchen,0.5\n";
    let second = whole.find("2,").unwrap_or_default();
    for cut in second + 1..whole.len() {
        let items = read(&whole.as_bytes()[..cut])?;
        match &items[1] {
            RowItem::Torn { line: 3, text } => assert_eq!(*text, whole[second..cut]),
            RowItem::Row(row) => assert!(row.wrong.is_none() && cut >= whole.len() - 4, "{cut} {row:?}"),
            other => panic!("{other:?}"),
        }
    }
    Ok(())
}

#[test]
fn a_last_line_without_an_end_is_a_row_only_where_that_is_allowed() -> Result<(), RowError> {
    let text = b"time,state,value\n1,a,0\n2,a,1".as_slice();
    let items = read(text)?;
    assert_eq!(good(&items).len(), 2);
    let ends: Vec<bool> = items.iter().map(|item| matches!(item, RowItem::Row(row) if row.has_end)).collect();
    assert_eq!(ends, [true, false]);
    let mut rows = RowReader::new(text)?.lines_must_end();
    assert!(matches!(rows.next_item()?, Some(RowItem::Row(_))));
    assert!(matches!(rows.next_item()?, Some(RowItem::Torn { line: 3, text }) if text == "2,a,1"));
    assert!(rows.next_item()?.is_none());
    // A row with a value out of range is complete.
    assert!(matches!(read(b"time,state,value\n1,a,2")?.as_slice(), [RowItem::Row(row)] if row.wrong.is_some()));
    Ok(())
}

/// A file that grows whenever its end was read.
struct Growing(Vec<&'static [u8]>);

impl io::Read for Growing {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let piece = if self.0.is_empty() { b"".as_slice() } else { self.0.remove(0) };
        buffer[..piece.len()].copy_from_slice(piece);
        Ok(piece.len())
    }
}

#[test]
fn a_file_that_grows_while_it_is_read_is_not_read_past_its_end() -> Result<(), RowError> {
    for (last, torn) in [("2,a", true), ("2,a,0", false), ("  ", true), ("", true)] {
        let pieces = vec![b"time,state,value\n1,a,0\n".as_slice(), last.as_bytes(), b"", b".5\n3,a,1\n", b""];
        let mut rows = RowReader::new(io::BufReader::new(Growing(pieces)))?;
        let mut items = Vec::new();
        while let Some(item) = rows.next_item()? {
            items.push(item);
        }
        assert!(rows.next_item()?.is_none(), "{last:?}");
        assert_eq!(good(&items).len(), if torn { 1 } else { 2 }, "{last:?}");
    }
    Ok(())
}

/// The coordinates of a row, and its error.
type Read = (Option<Vec<f64>>, Option<String>);

#[test]
fn positions_have_two_coordinates_or_three_in_any_order() -> Result<(), RowError> {
    let positions = |text: &str| -> Result<Vec<Read>, RowError> {
        let items = read(text.as_bytes())?;
        let row = |item: &RowItem| match item {
            RowItem::Row(row) => (row.position.map(|position| position.coordinates().to_vec()), row.wrong.clone()),
            other => panic!("{other:?}"),
        };
        Ok(items.iter().map(row).collect())
    };
    assert_eq!(positions("time,state,x,y\n1,anna,-0,2.5\n")?, [(Some(vec![0.0, 2.5]), None)]);
    assert_eq!(positions("z,state,y,time,X\n3,anna,2,7,1\n")?, [(Some(vec![1.0, 2.0, 3.0]), None)]);
    // With a column `value`, the other columns are ignored.
    assert_eq!(positions("time,state,value,x,y\n1,door,1,2,3\n")?, [(None, None)]);
    for (row, reason) in [
        ("1,anna,,2", "x \"\" is not a number"),
        ("1,anna,1,there", "y \"there\" is not a number"),
        ("soon,anna,1,2", "time"),
        ("1,anna,1", "\"1,anna,1\" has 3 fields"),
    ] {
        let found = positions(&format!("time,state,x,y\n{row}\n"))?;
        let [(Some(coordinates), Some(wrong))] = found.as_slice() else { panic!("{found:?}") };
        assert!(coordinates.len() == 2 && coordinates.iter().all(|number| number.is_nan()), "{coordinates:?}");
        assert!(wrong.starts_with(reason), "{wrong}");
    }
    let far = positions("time,state,x,y\n1,anna,2,1e13\n")?;
    assert_eq!(far[0].1.as_deref(), Some("y 10000000000000 is not a number from -1e12 to 1e12"));
    let message = |text: &str| positions(text).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(
        message("time,state,x\n").starts_with("column \"y\" is missing: the header must name time, state, x and y")
    );
    assert!(message("time,state,x,y,x\n").starts_with("column \"x\" appears twice"));
    assert!(matches!(RowReader::new(b"time,state,x,y\n".as_slice())?.values_only(), Err(RowError::Positions)));
    Ok(())
}

fn read_by(rules: &RowRules, text: &str) -> Result<Vec<ObservationRow>, RowError> {
    let mut rows = RowReader::<_, ObservationColumns>::open_with(text.as_bytes(), rules)?;
    let mut found = Vec::new();
    while let Some(item) = rows.next_item()? {
        if let RowItem::Row(row) = item {
            found.push(row);
        }
    }
    Ok(found)
}

#[test]
fn columns_words_and_times_of_the_file_are_read_by_its_rules() -> Result<(), RowError> {
    let rules = RowRules {
        columns: RowRules::parse_columns("time=When,state=entity,value=what").expect("columns"),
        words: RowRules::parse_words("half=0.5,jammed=none").expect("words"),
        zone: Some(tidemap_model::Zone::named("Europe/Berlin").expect("a zone")),
        kind: RowKind::Changes,
        labelled: Vec::new(),
    };
    // Clocks go back on 26 October at three: the hour from two comes twice. On 30 March it does not come at all.
    let text = "entity,what,when\nlamp,on,2025-10-26 01:30:00\nlamp,half,2025-10-26T02:30\nlamp,OFF,2025-10-26T02:10\n\
                lamp,unavailable,2025-10-26T03:00:00\nlamp,jammed,1761447600\nlamp,on,2025-03-30T02:30\nlamp,?,2025-10-27\n";
    let rows = read_by(&rules, text)?;
    let secs: Vec<i64> = rows.iter().take(5).map(|row| row.time_nanos / SECOND).collect();
    assert_eq!(secs, [1_761_435_000, 1_761_438_600, 1_761_441_000, 1_761_444_000, 1_761_447_600]);
    let values: Vec<f64> = rows.iter().take(3).map(|row| row.value).collect();
    assert_eq!(values, [1.0, 0.5, 0.0]);
    assert!(rows[3..5].iter().all(|row| row.value.is_nan() && row.wrong.is_none()));
    let wrong = |row: &ObservationRow| row.wrong.clone().unwrap_or_default();
    assert!(wrong(&rows[5]).contains("does not exist in Europe/Berlin"), "{}", wrong(&rows[5]));
    assert!(wrong(&rows[6]).contains("--values ?=1"), "{}", wrong(&rows[6]));
    // The daemon takes NaN as a row without a value, and refuses these.
    assert!(rows[5..].iter().all(|row| row.value == f64::INFINITY));
    Ok(())
}

#[test]
fn rules_that_are_none_are_refused() {
    for (text, words) in [("time", "time=last_changed"), ("clock=x", "\"clock=x\""), ("time=a,time=b", "named twice")] {
        let error = RowRules::parse_columns(text).expect_err("no columns").to_string();
        assert!(error.contains(words), "{text}: {error}");
    }
    for (text, words) in [("on", "on=1"), ("on=much", "\"much\""), ("on=1,ON=0", "twice"), ("on=inf", "\"inf\"")] {
        let error = RowRules::parse_words(text).expect_err("no words").to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn events_need_no_value() -> Result<(), RowError> {
    let rules = RowRules { kind: RowKind::Events, ..RowRules::default() };
    let values =
        |text: &str| -> Result<Vec<f64>, RowError> { Ok(read_by(&rules, text)?.iter().map(|row| row.value).collect()) };
    assert_eq!(values("time,state\n1,gate\n2,gate\n")?, [1.0, 1.0]);
    assert_eq!(values("time,state,value\n1,gate,pressed\n2,gate,3\n")?, [1.0, 3.0]);
    assert!(values("time,state,value\n1,gate,unavailable\n")?[0].is_nan());
    assert!(matches!(read_by(&RowRules::default(), "time,state\n1,gate\n"), Err(RowError::MissingColumn { .. })));
    Ok(())
}

#[test]
fn columns_with_another_separator_are_reported() {
    for (header, words) in [
        ("time;state;value\n", "semicolons"),
        ("time\tstate\tvalue\n", "tabs"),
        ("time|state|value\n", "bars"),
        ("time state value\n", "column \"time\" is missing"),
        ("when;x,state,value\n", "column \"time\" is missing"),
    ] {
        let error = RowReader::new(header.as_bytes()).map(|_| ()).expect_err(header).to_string();
        assert!(error.contains(words), "{header}: {error}");
    }
    let error = RowReader::new("time;state;value\n".as_bytes()).map(|_| ()).expect_err("a separator").to_string();
    assert!(error.contains("tr ';' ',' < FILE > NEW"), "{error}");
}

#[test]
fn the_error_of_a_word_for_a_number_out_of_range_names_both() -> Result<(), RowError> {
    let words = RowRules::parse_words("ajar=5").expect("words");
    let rules = RowRules { words, ..RowRules::default() };
    let mut rows = RowReader::<_, ObservationColumns>::open_with("time,state,value\n1,door,ajar\n".as_bytes(), &rules)?;
    let Some(RowItem::Row(row)) = rows.next_item()? else { panic!("a row") };
    assert_eq!(row.value, 5.0);
    assert_eq!(row.wrong.as_deref(), Some("value \"ajar\" means 5, which is not between 0 and 1"));
    Ok(())
}

#[test]
fn values_are_labels_where_the_rules_define_it() -> Result<(), Box<dyn std::error::Error>> {
    let pattern = |text: &str| text.chars().collect::<Vec<char>>();
    let labelled = vec![(pattern("activity-2"), false), (pattern("activity*"), true)];
    let rules = RowRules { labelled, ..RowRules::default() };
    let text = "time,state,value\n1,activity,On the phone\n2,door,1\n3,activity,a/b\n4,activity-2,1\n5,activity,\n";
    let mut rows = RowReader::<_, ObservationColumns>::open_with(text.as_bytes(), &rules)?;
    let mut found = Vec::new();
    while let Some(RowItem::Row(row)) = rows.next_item()? {
        found.push((row.name_sent().into_owned(), row.value, row.wrong.is_some()));
    }
    let name = |text: &str| text.to_owned();
    assert_eq!(found[0], (name("activity/On the phone"), 1.0, false));
    assert_eq!(found[1], (name("door"), 1.0, false));
    assert!(found[2].1.is_nan() && found[2].2, "{found:?}");
    assert_eq!(found[3], (name("activity-2"), 1.0, false));
    assert!(found[4].2, "no label");
    Ok(())
}
