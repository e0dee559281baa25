//! The columns of a table, from the statement that made it.
//!
//! Invariant: any text gives some columns, perhaps none; never a panic.

/// The names of the columns, and the index of the column that is an alias of the row number.
pub(super) fn columns(sql: &str) -> (Vec<String>, Option<usize>) {
    let (mut names, mut row_number, mut keys) = (Vec::new(), None, Vec::new());
    let mut integers = Vec::new();
    for part in parts(sql) {
        let words: Vec<String> = part.iter().map(|word| word.to_ascii_uppercase()).collect();
        let Some(name) = part.first() else { continue };
        let is_key = words.windows(2).any(|pair| pair[0] == "PRIMARY" && pair[1] == "KEY");
        match words[0].as_str() {
            // A quote before the word means that it is a name.
            "PRIMARY" | "UNIQUE" | "CHECK" | "FOREIGN" | "CONSTRAINT" => {
                if is_key {
                    keys = part;
                }
                continue;
            }
            _ => {}
        }
        let is_integer = words.get(1).is_some_and(|word| word == "INTEGER");
        if is_integer && is_key && !words.iter().any(|word| word == "DESC") {
            row_number = Some(names.len());
        }
        integers.push(is_integer);
        names.push(unquoted(name));
    }
    if row_number.is_none() {
        // PRIMARY KEY (column), as a line of its own.
        let inside: Vec<&String> = keys.iter().skip_while(|word| *word != "(").skip(1).collect();
        if let [name, end] = inside[..]
            && end == ")"
        {
            let name = unquoted(name);
            row_number = names
                .iter()
                .zip(&integers)
                .position(|(column, is_integer)| *is_integer && column.eq_ignore_ascii_case(&name));
        }
    }
    (names, row_number)
}

/// The parts between the outer parentheses, split at their commas, as words.
fn parts(sql: &str) -> Vec<Vec<String>> {
    let words = words(sql);
    let inside = words.into_iter().skip_while(|word| word != "(").skip(1);
    let (mut parts, mut part, mut depth) = (Vec::new(), Vec::new(), 0_usize);
    for word in inside {
        match word.as_str() {
            ")" if depth == 0 => break,
            "," if depth == 0 => {
                parts.push(std::mem::take(&mut part));
                continue;
            }
            "(" => depth += 1,
            ")" => depth -= 1,
            _ => {}
        }
        part.push(word);
    }
    parts.push(part);
    parts
}

/// Names, quoted names with their quotes, and single signs; without comments.
fn words(sql: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut rest = sql.trim_start();
    while let Some(first) = rest.chars().next() {
        let length = match first {
            '"' | '`' | '\'' | '[' => quoted_bytes(rest, if first == '[' { ']' } else { first }),
            '-' if rest.starts_with("--") => {
                rest = rest.split_once('\n').map_or("", |(_, after)| after).trim_start();
                continue;
            }
            '/' if rest.starts_with("/*") => {
                rest = rest.split_once("*/").map_or("", |(_, after)| after).trim_start();
                continue;
            }
            first if is_letter(first) => rest.find(|sign| !is_letter(sign)).unwrap_or(rest.len()),
            first => first.len_utf8(),
        };
        let (word, after) = rest.split_at(length);
        words.push(word.to_owned());
        rest = after.trim_start();
    }
    words
}

fn is_letter(sign: char) -> bool {
    sign.is_alphanumeric() || sign == '_' || sign == '$'
}

/// Length of a quoted name; a quote inside is doubled.
fn quoted_bytes(text: &str, quote: char) -> usize {
    let mut signs = text.char_indices().skip(1).peekable();
    while let Some((at, sign)) = signs.next() {
        if sign != quote {
            continue;
        }
        if quote != ']' && signs.peek().is_some_and(|(_, next)| *next == quote) {
            signs.next();
        } else {
            return at + sign.len_utf8();
        }
    }
    text.len()
}

fn unquoted(word: &str) -> String {
    let inner = |quote: char, end: char| word.strip_prefix(quote)?.strip_suffix(end);
    for quote in ['"', '`', '\''] {
        if let Some(name) = inner(quote, quote) {
            return name.replace(&format!("{quote}{quote}"), &quote.to_string());
        }
    }
    inner('[', ']').unwrap_or(word).to_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn found(sql: &str) -> (String, Option<usize>) {
        let (names, row_number) = columns(sql);
        (names.join("|"), row_number)
    }

    #[test]
    fn columns_are_named_in_their_order() {
        let sql = "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, \
                   data BLOB NOT NULL)";
        assert_eq!(found(sql), ("id|topic_id|timestamp|data".to_owned(), Some(0)));
    }

    #[test]
    fn quotes_comments_and_lines_that_are_no_columns_are_understood() {
        let sql = "CREATE TABLE \"a(b\" (\n  \"the \"\"name\" TEXT DEFAULT ('x, y'), -- a comment, with (\n  [key] integer,\
                   \n  /* , */ `primary` DECIMAL(10, 2), CHECK (key > 0), PRIMARY KEY (\"KEY\")\n)";
        assert_eq!(found(sql), ("the \"name|key|primary".to_owned(), Some(1)));
    }

    #[test]
    fn only_a_whole_number_means_the_number_of_the_row() {
        assert_eq!(found("CREATE TABLE a(id INT PRIMARY KEY)").1, None);
        assert_eq!(found("CREATE TABLE a(id INTEGER, b INTEGER, PRIMARY KEY (id, b))").1, None);
        assert_eq!(found("CREATE TABLE a(id INTEGER PRIMARY KEY DESC)").1, None);
    }

    proptest! {
        #[test]
        fn any_text_is_taken(sql in "[a(),\"'`\\[\\]\\-/* \né]{0,60}") {
            columns(&sql);
        }
    }
}
