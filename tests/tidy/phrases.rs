//! Names and comments that a reader understands without guessing.
//!
//! Invariant: strings are neither code nor comments.

use super::{files, hold, read};

/// Words without meaning as the name of a value. Name what the value is: a reply, a tile, a `state_kind`, a `max`.
const EMPTY_NAMES: [&str; 3] = ["told", "of", "most"];

/// A machine does not speak: it predicts, returns, reports, contains. No comment has these words, and no name.
const SPEECH: [&str; 10] = ["say", "says", "said", "tell", "tells", "told", "speak", "speaks", "spoke", "stands for"];

/// Words that begin a doc comment without a noun: "What is read" instead of "The data that is read".
const HEADLESS: [&str; 5] = ["What ", "Those ", "That of ", "Of ", "Likewise "];

/// Words for which the glossary has another: a model is trained on readings, and trained again.
const FOREIGN_WORDS: [&str; 3] = ["fit", "fitted", "refit"];

/// The words of speech in a text. Letters around a word make it another one.
fn speech(text: &str) -> Vec<&'static str> {
    let text = text.to_lowercase();
    let is_whole = |at: usize, word: &str| {
        let is_letter = |character: char| character.is_alphanumeric();
        !text[..at].ends_with(is_letter) && !text[at + word.len()..].starts_with(is_letter)
    };
    SPEECH.into_iter().filter(|word| text.match_indices(word).any(|(at, _)| is_whole(at, word))).collect()
}

/// Names with such a word that others have chosen: a function of the standard library, and scikit-learn's interface.
const GIVEN_NAMES: [(&str, &str); 2] = [("", "shrink_to_fit"), ("client/python/", "fit")];

/// A line of a file, split into its code and the text of its comment.
#[derive(Debug, Default, PartialEq)]
struct Line {
    /// The code without comments and without the contents of strings.
    code: String,
    /// The comment without the slashes in front; `None`: the line has no comment, or code in front of it.
    comment: Option<String>,
}

/// Where the text of a file is between two characters.
#[derive(Clone, Copy, PartialEq)]
enum Within {
    Code,
    /// A string that ends with a quote and this many `#`; `true`: a backslash escapes the next character.
    Text(usize, bool),
}

/// The lines of a Rust file.
fn lines(text: &str) -> Vec<Line> {
    let mut within = Within::Code;
    text.lines()
        .map(|line| {
            let mut found = Line::default();
            let mut rest = line;
            while let Some(next) = rest.chars().next() {
                let mut length = next.len_utf8();
                match within {
                    Within::Text(_, true) if next == '\\' => {
                        length += rest[length..].chars().next().map_or(0, char::len_utf8);
                    }
                    Within::Text(hashes, _) => {
                        if next == '"' && rest[1..].starts_with(&"#".repeat(hashes)) {
                            length += hashes;
                            within = Within::Code;
                            found.code.push('"');
                        }
                    }
                    Within::Code if rest.starts_with("//") => {
                        let comment = rest.trim_start_matches('/').trim_start_matches('!').trim();
                        found.comment = found.code.trim().is_empty().then(|| comment.to_owned());
                        length = rest.len();
                    }
                    Within::Code if ["'\"'", "'\\\"'"].iter().any(|quote| rest.starts_with(quote)) => {
                        length = if rest.starts_with("'\\") { 4 } else { 3 };
                    }
                    Within::Code => {
                        if next == '"' {
                            let before = found.code.trim_end_matches('#');
                            let is_raw = before.ends_with('r');
                            let hashes = if is_raw { found.code.len() - before.len() } else { 0 };
                            within = Within::Text(hashes, !is_raw);
                        }
                        found.code.push(next);
                    }
                }
                rest = &rest[length..];
            }
            found
        })
        .collect()
}

/// The empty names that a line of code gives to a value. A method or an associated function may be called `of`: it is
/// read together with its type, as in `Dimensions::of(3)`.
fn empty_names(code: &str) -> Vec<&'static str> {
    let is_word = |character: char| character.is_alphanumeric() || character == '_';
    let is_name = |at: usize, name: &str| {
        let (before, after) = (&code[..at], &code[at + name.len()..]);
        let is_whole = !before.ends_with(is_word) && !after.starts_with(is_word);
        let is_called = before.ends_with("::") || (before.ends_with('.') && after.starts_with('('));
        let is_method = code.starts_with(' ') && before.ends_with("fn ");
        is_whole && !(name == "of" && (is_called || is_method))
    };
    EMPTY_NAMES.into_iter().filter(|name| code.match_indices(name).any(|(at, _)| is_name(at, name))).collect()
}

/// The names in a line of code that begin or end with a foreign word. Inside a name it has its plain meaning, as in
/// `does_not_fit_through_the_door`.
fn foreign_names(code: &str) -> Vec<&str> {
    let names = code.split(|character: char| !character.is_alphanumeric() && character != '_');
    let is_foreign = |name: &&str| {
        let starts = name.char_indices().filter(|&(at, letter)| at > 0 && (letter.is_uppercase() || letter == '_'));
        let is_constant = !name.contains(char::is_lowercase);
        let cuts: Vec<usize> = starts.filter(|&(_, letter)| !is_constant || letter == '_').map(|(at, _)| at).collect();
        let (first, last) = match (cuts.first(), cuts.last()) {
            (Some(&first), Some(&last)) => (&name[..first], &name[last..]),
            _ => (*name, *name),
        };
        [first, last].iter().any(|part| FOREIGN_WORDS.contains(&part.trim_matches('_').to_lowercase().as_str()))
    };
    names.filter(is_foreign).collect()
}

/// Whether a comment has no meaning by itself: "The same …" as what? "Its name." of what, and which names are there?
fn is_empty_comment(comment: &[String]) -> bool {
    let has_only_its = |text: &str| {
        let words: Vec<&str> = text.split(' ').collect();
        let is_bare = text.ends_with('.') && !text.contains([',', ':', '`']);
        is_bare && matches!(words[..], ["Its" | "Their", _] | ["Its" | "Their", _, _])
    };
    let begins_again = comment.first().is_some_and(|line| line.starts_with("The same"));
    begins_again || matches!(comment, [line] if has_only_its(line))
}

/// The paragraphs of comments: number of the first line, and the lines.
fn paragraphs(lines: &[Line]) -> Vec<(usize, Vec<String>)> {
    let mut found: Vec<(usize, Vec<String>)> = Vec::new();
    let mut is_open = false;
    for (number, line) in lines.iter().enumerate() {
        let comment = line.comment.clone().filter(|comment| !comment.is_empty());
        let was_open = std::mem::replace(&mut is_open, comment.is_some());
        match (comment, found.last_mut()) {
            (Some(comment), Some((_, paragraph))) if was_open => paragraph.push(comment),
            (Some(comment), _) => found.push((number + 1, vec![comment])),
            (None, _) => {}
        }
    }
    found
}

#[test]
fn names_state_what_a_value_is() {
    let mut broken = Vec::new();
    for path in &files(".", ".rs") {
        for (number, line) in lines(&read(path)).iter().enumerate() {
            for name in empty_names(&line.code) {
                broken.push(format!("{path}:{}: `{name}` does not describe the value", number + 1));
            }
        }
    }
    hold(&broken);
}

#[test]
fn names_use_the_words_of_the_glossary() {
    let mut broken = Vec::new();
    for path in &files(".", ".rs") {
        for (number, line) in lines(&read(path)).iter().enumerate() {
            let names = foreign_names(&line.code).into_iter();
            let is_given =
                |name: &str| GIVEN_NAMES.iter().any(|&(folder, given)| path.starts_with(folder) && name == given);
            for name in names.filter(|name| !is_given(name)) {
                broken.push(format!("{path}:{}: `{name}`: the word is train, see the glossary", number + 1));
            }
        }
    }
    hold(&broken);
}

#[test]
fn comments_can_be_read_alone() {
    let mut broken = Vec::new();
    for path in files(".", ".rs").into_iter().chain(files(".", ".proto")) {
        let text = read(&path);
        for (number, comment) in paragraphs(&lines(&text)) {
            if is_empty_comment(&comment) {
                broken.push(format!("{path}:{number}: {:?} means nothing by itself: name what it is", comment[0]));
            }
        }
    }
    hold(&broken);
}

#[test]
fn a_machine_does_not_speak() {
    let mut broken = Vec::new();
    for path in files(".", ".rs").into_iter().chain(files(".", ".proto")) {
        if path.ends_with("tests/tidy/phrases.rs") {
            continue;
        }
        for (number, line) in lines(&read(&path)).iter().enumerate() {
            for word in speech(line.comment.as_deref().unwrap_or_default()).into_iter().chain(speech(&line.code)) {
                broken.push(format!("{path}:{}: {word:?}: predicts, returns, reports, contains, …", number + 1));
            }
        }
    }
    hold(&broken);
}

#[test]
fn doc_comments_begin_with_a_noun_or_a_verb() {
    let mut broken = Vec::new();
    for path in files(".", ".rs").into_iter().chain(files(".", ".proto")) {
        let text = read(&path);
        let is_doc = |number: usize| {
            let line = text.lines().nth(number - 1).unwrap_or_default().trim_start();
            line.starts_with("///") || line.starts_with("//!") || path.ends_with(".proto")
        };
        for (number, comment) in paragraphs(&lines(&text)) {
            let is_headless = HEADLESS.iter().any(|word| comment[0].starts_with(word));
            if is_headless && is_doc(number) {
                broken.push(format!("{path}:{number}: {:?}: begin with a noun or a verb", comment[0]));
            }
        }
    }
    hold(&broken);
}

#[test]
fn the_rules_of_phrases_can_fail() {
    assert_eq!(speech("It says so; as_told, toll, Saying"), ["says", "told"]);
    assert_eq!(speech("x stands for y"), ["stands for"]);
    let text = "let told = 1; // of it\n/// The same\nlet a = \"of // most\n told\"; f(most);\nlet b = r#\"\"of\"#; g('\"', of);\n";
    let split = lines(text);
    let codes: Vec<&str> = split.iter().map(|line| line.code.as_str()).collect();
    assert_eq!(codes, ["let told = 1; ", "", "let a = \"", "\"; f(most);", "let b = r#\"\"; g(, of);"]);
    assert_eq!(split[1].comment.as_deref(), Some("The same"));
    assert_eq!(split[0].comment, None);
    assert_eq!(empty_names("let told = told_before;"), ["told"]);
    assert_eq!(empty_names("    fn new(of: u8, most: u8) {"), ["of", "most"]);
    assert_eq!(empty_names("sums.of.iter()"), ["of"]);
    assert_eq!(empty_names("fn of(py: u8) {"), ["of"]);
    assert_eq!(empty_names("    pub fn of(count: usize) -> Dimensions { Dimensions::of(row.of(1), of_day) }"), [""; 0]);
    let foreign = ["fit", "fitted", "fit_weighted", "CannotFit", "FitStop", "max_refit", "REFIT_DAYS"];
    assert_eq!(foreign_names(&foreign.join("(")), foreign);
    assert_eq!(foreign_names("Misfit fits outfit it_does_not_fit_in FITNESS retrained"), [""; 0]);
    let comment = |text: &'static str| paragraphs(&lines(text)).into_iter().next().expect("a comment").1;
    assert!(is_empty_comment(&comment("/// The same without\n/// sums.")));
    assert!(is_empty_comment(&comment("    // Its private key.")));
    assert!(!is_empty_comment(&comment("/// This is\n/// The same day.")));
    assert!(!is_empty_comment(&comment("/// Its name, unique in the map.")));
    assert!(!is_empty_comment(&comment("/// Name of the map.\n/// Its owner.")));
    assert_eq!(paragraphs(&lines("/// A\n/// b\n\n/// C\n///\n/// d")).len(), 3);
}
