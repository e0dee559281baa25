//! The three forms of one result.

use super::*;

fn written(format: Format, rows: &[Vec<Cell>]) -> io::Result<String> {
    let mut bytes = Vec::new();
    let mut table = TableWriter::new(format, &["state", "n", "p", "time"], &mut bytes);
    for row in rows {
        table.row(row.clone())?;
    }
    table.finish()?;
    String::from_utf8(bytes).map_err(io::Error::other)
}

fn rows() -> Vec<Vec<Cell>> {
    vec![
        vec!["the \"red\" door, left".into(), 12_u64.into(), (1.0 / 3.0).into(), Cell::Secs(1_458_518_400_250_000_000)],
        vec!["b".into(), 3_u64.into(), f64::NAN.into(), Cell::Empty],
    ]
}

#[test]
fn csv_is_exact_and_quoted_where_needed() -> io::Result<()> {
    assert_eq!(
        written(Format::Csv, &rows())?,
        "state,n,p,time\n\"the \"\"red\"\" door, left\",12,0.3333333333333333,1458518400.25\nb,3,NaN,\n"
    );
    assert_eq!(written(Format::Csv, &[])?, "state,n,p,time\n");
    Ok(())
}

#[test]
fn json_is_an_array_of_objects_that_a_parser_accepts() -> io::Result<()> {
    let text = written(Format::Json, &rows())?;
    assert_eq!(
        text,
        "[{\"state\":\"the \\\"red\\\" door, left\",\"n\":12,\"p\":0.3333333333333333,\"time\":1458518400.25},\n \
         {\"state\":\"b\",\"n\":3,\"p\":null,\"time\":null}]\n"
    );
    let value: serde_json::Value = serde_json::from_str(&text)?;
    assert_eq!(value[1]["n"], 3);
    assert_eq!(written(Format::Json, &[])?, "[]\n");
    Ok(())
}

#[test]
fn a_table_rounds_and_aligns() -> io::Result<()> {
    let text = written(Format::Table, &rows())?;
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 3, "{text}");
    assert!(lines[1].contains(" 0.333 "), "{text}");
    assert_eq!(lines[1].find("12"), lines[2].find(" 3"), "numbers stand under each other's last digit:\n{text}");
    assert!(written(Format::Table, &[])?.starts_with("state"));
    Ok(())
}

#[test]
fn decimal_points_stand_below_each_other() -> io::Result<()> {
    let row = |p: f64| vec!["s".into(), 1_u64.into(), p.into(), Cell::Time(1_458_518_400_000_000_000)];
    let text = written(Format::Table, &[row(0.5), row(12.25), row(3.0)])?;
    let points: Vec<Option<usize>> = text.lines().skip(1).take(2).map(|line| line.find('.')).collect();
    assert!(points[0].is_some() && points[0] == points[1], "{text}");
    let mut bytes = Vec::new();
    let style = TimeStyle::Clock(tidemap_model::Zone::utc());
    write_rows_at(Format::Table, &style, &["p", "time"], [vec![0.5.into(), Cell::Time(0)]], &mut bytes)?;
    let text = String::from_utf8_lossy(&bytes).into_owned();
    assert!(text.contains("time (UTC)") && text.contains("Thu 1970-01-01 00:00"), "{text}");
    bytes.clear();
    write_rows_at(Format::Csv, &style, &["p", "time"], [vec![0.5.into(), Cell::Time(0)]], &mut bytes)?;
    assert_eq!(bytes, b"p,time\n0.5,0\n", "programs get the same in every style");
    Ok(())
}

#[test]
fn people_see_no_columns_that_they_do_not_need() -> io::Result<()> {
    let columns = ["state", "age_secs", "lower", "order"];
    let row = vec!["door".into(), Cell::Secs(87_720_000_000_000), Cell::Empty, 3_u64.into()];
    let text = |format| -> io::Result<String> {
        let mut bytes = Vec::new();
        let mut table = TableWriter::new(format, &columns, &mut bytes).hiding(&["order"]);
        table.row(row.clone())?;
        table.finish()?;
        String::from_utf8(bytes).map_err(io::Error::other)
    };
    assert_eq!(text(Format::Table)?, "state     age\ndoor   24.4 h\n");
    assert_eq!(text(Format::Csv)?, "state,age_secs,lower,order\ndoor,87720,,3\n");
    Ok(())
}

/// A writer whose reader is gone.
struct Gone;

impl Write for Gone {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::BrokenPipe.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_reader_that_has_gone_away_is_recognised_by_the_kind_of_error() {
    let mut table = TableWriter::new(Format::Csv, &["a"], Gone);
    let result = table.row(vec![Cell::Empty]);
    assert_eq!(result.map_err(|error| error.kind()), Err(io::ErrorKind::BrokenPipe));
}

/// Stores the output, and whether any of it was not flushed.
#[derive(Default)]
struct Flushed {
    written: String,
    unflushed: bool,
}

impl Write for &mut Flushed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.written.push_str(&String::from_utf8_lossy(bytes));
        self.unflushed = true;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.unflushed = false;
        Ok(())
    }
}

#[test]
fn rows_that_come_one_by_one_are_whole_lines_at_once() -> io::Result<()> {
    for (format, expected) in [
        (Format::Csv, "state,n,p,time\nb,3,NaN,\nb,3,NaN,\n"),
        (
            Format::Json,
            "[{\"state\":\"b\",\"n\":3,\"p\":null,\"time\":null}\n,{\"state\":\"b\",\"n\":3,\"p\":null,\"time\":null}\n]\n",
        ),
        (
            Format::Table,
            "state           n               p               time\nb               3               NaN\n\
             b               3               NaN\n",
        ),
    ] {
        let mut kept = Flushed::default();
        let mut table = TableWriter::new(format, &["state", "n", "p", "time"], &mut kept).live()?;
        for row in 1..=2 {
            table.row(rows().remove(1))?;
            assert!(!table.writer.unflushed, "row {row}");
            assert!(table.writer.written.ends_with('\n'));
        }
        table.finish()?;
        assert_eq!(kept.written, expected);
    }
    // The header comes before the first row, and the output is valid at the end.
    let mut kept = Flushed::default();
    let table = TableWriter::new(Format::Csv, &["state"], &mut kept).live()?;
    assert_eq!((table.writer.written.as_str(), table.writer.unflushed), ("state\n", false));
    table.finish()?;
    assert_eq!(kept.written, "state\n");
    let mut kept = Flushed::default();
    TableWriter::new(Format::Json, &["state"], &mut kept).live()?.finish()?;
    assert_eq!(kept.written, "[]\n");
    Ok(())
}

#[test]
fn a_list_is_a_list_in_json_and_words_elsewhere() {
    let list = Cell::List(vec!["a \"b\"".into(), 0.5.into(), Cell::Empty]);
    assert_eq!(list.json(), "[\"a \\\"b\\\"\",0.5,null]");
    assert_eq!(Cell::texts(["door", "window"]).exact(), "door window");
    assert_eq!(Cell::texts(Vec::<String>::new()).json(), "[]");
}

#[test]
fn people_see_the_unit_of_coordinates() -> io::Result<()> {
    let row = || [vec![1.5.into(), 2_u64.into()]];
    for (format, header) in [(Format::Table, "x (m)  states"), (Format::Csv, "x,states")] {
        let mut bytes = Vec::new();
        write_rows(format, &["x", "states"], row(), &mut bytes)?;
        let text = String::from_utf8(bytes).map_err(io::Error::other)?;
        assert!(text.starts_with(header), "{text}");
    }
    Ok(())
}
