//! No import circles between the files of a crate, of the Python package or of the page, nor between the rooms of a
//! folder.
//!
//! A file may use the modules that it lies in, and a module the files below it: that is one room with its inner rooms.
//! Every other use is an arrow, and arrows must not run in a circle. A name that a module only re-exports counts as
//! its origin's.
//!
//! Invariant: what is read are `use` declarations and full paths in code; tests are left out.

use std::collections::{BTreeMap, BTreeSet};

use super::{APART, CRATES, code, hold, read, sources};

mod scripts;

/// A path of names: of a module within its crate, or of an item.
type Names = Vec<String>;

/// One `use` declaration, taken apart into single names.
struct Import {
    path: Names,
    name: String,
    is_public: bool,
}

/// The parts of a list, split at the commas that are in no braces.
fn parts(list: &str) -> Vec<&str> {
    let (mut depth, mut start, mut parts) = (0, 0, Vec::new());
    for (at, character) in list.char_indices() {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&list[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&list[start..]);
    parts
}

/// Takes `a::{b, c::d as e}` apart into `a::b` and `a::c::d`.
fn take_apart(tree: &str, before: &[String], is_public: bool, imports: &mut Vec<Import>) {
    let tree = tree.trim();
    let (path, last) = tree.split_once('{').unwrap_or_else(|| {
        let at = tree.rfind("::").map_or(0, |at| at + 2);
        tree.split_at(at)
    });
    let mut names: Names = before.to_vec();
    names.extend(path.split("::").map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned));
    if tree.contains('{') {
        let list = last.trim_end().strip_suffix('}').unwrap_or(last);
        for part in parts(list).into_iter().filter(|part| !part.trim().is_empty()) {
            take_apart(part, &names, is_public, imports);
        }
        return;
    }
    let (item, name) = last.split_once(" as ").unwrap_or((last, last));
    let (item, name) = (item.trim(), name.trim());
    if item != "self" {
        names.push(item.to_owned());
    }
    imports.push(Import { path: names, name: name.to_owned(), is_public });
}

/// The imports of code, and the code without them.
fn imports(code: &str) -> (Vec<Import>, String) {
    let (mut imports, mut rest) = (Vec::new(), String::new());
    let mut lines = code.lines();
    while let Some(line) = lines.next() {
        let start = line.trim_start();
        let after = start.strip_prefix("pub").map_or(start, |after| match after.strip_prefix('(') {
            Some(scope) => scope.split_once(')').map_or(start, |(_, after)| after),
            None => after,
        });
        let Some(tree) = after.trim_start().strip_prefix("use ") else {
            rest.push_str(line);
            rest.push('\n');
            continue;
        };
        let mut tree = tree.to_owned();
        while !tree.contains(';') {
            let Some(more) = lines.next() else { break };
            tree.push_str(more.trim());
        }
        take_apart(tree.split(';').next().unwrap_or_default(), &[], start.starts_with("pub"), &mut imports);
    }
    (imports, rest)
}

/// Paths such as `crate::a::b` that stand in code.
fn paths(code: &str) -> Vec<Names> {
    let in_path = |character: char| character.is_alphanumeric() || character == '_' || character == ':';
    let words = code.split(|character| !in_path(character)).filter(|word| word.contains("::"));
    words.map(|word| word.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect()).collect()
}

/// The modules of a crate and what they import.
#[derive(Default)]
struct Crate {
    /// The files by the path of the module.
    modules: BTreeMap<Names, String>,
    /// The names that a module re-exports: by the name there, the path of the origin.
    public: BTreeMap<Names, BTreeMap<String, Names>>,
    /// The names that a module uses, as paths from the crate's root.
    used: BTreeMap<Names, Vec<Names>>,
}

impl Crate {
    fn read(folder: &str) -> Crate {
        let start = format!("{folder}/src/");
        Crate::of(sources(folder).into_iter().map(|path| {
            let module = path.trim_start_matches(&start).trim_end_matches(".rs").to_owned();
            let text = read(&path);
            (module, path, code(&text))
        }))
    }

    fn of(files: impl IntoIterator<Item = (String, String, String)>) -> Crate {
        let mut all = Crate::default();
        let mut codes = Vec::new();
        for (module, path, code) in files {
            let names = match module.as_str() {
                "lib" | "main" => Names::new(),
                _ => module.split('/').map(str::to_owned).collect(),
            };
            // A program beside its library contains no more than its start.
            if all.modules.contains_key(&names) {
                continue;
            }
            all.modules.insert(names.clone(), path);
            codes.push((names, code));
        }
        for (module, code) in codes {
            let (imports, rest) = imports(&code);
            for import in imports {
                let Some(path) = all.names_below_root(&module, &import.path) else { continue };
                if import.is_public {
                    all.public.entry(module.clone()).or_default().insert(import.name, path);
                } else {
                    all.used.entry(module.clone()).or_default().push(path);
                }
            }
            let full =
                paths(&rest).into_iter().filter_map(|path| all.names_below_root(&module, &path)).collect::<Vec<_>>();
            all.used.entry(module).or_default().extend(full);
        }
        all
    }

    /// A path as seen from a module, from the crate's root; `None` where it leads out of the crate.
    fn names_below_root(&self, module: &[String], path: &[String]) -> Option<Names> {
        let mut root = module.to_vec();
        let mut path = path;
        match path.first()?.as_str() {
            "crate" => {
                root.clear();
                path = &path[1..];
            }
            "self" => path = &path[1..],
            "super" => {
                while path.first().is_some_and(|name| name == "super") {
                    root.pop()?;
                    path = &path[1..];
                }
            }
            child => {
                let below: Names = root.iter().cloned().chain([child.to_owned()]).collect();
                self.modules.get(&below)?;
            }
        }
        root.extend(path.iter().cloned());
        Some(root)
    }

    /// The module that an item comes from.
    fn origin(&self, path: &[String], depth: usize) -> Option<Names> {
        let length = (0..=path.len()).rev().find(|&length| self.modules.contains_key(&path[..length]))?;
        let (module, rest) = path.split_at(length);
        let public = rest.first().and_then(|name| self.public.get(module)?.get(name));
        match public {
            Some(origin) if depth < 8 => {
                let path: Names = origin.iter().chain(&rest[1..]).cloned().collect();
                self.origin(&path, depth + 1)
            }
            _ => Some(module.to_vec()),
        }
    }

    fn arrows(&self) -> BTreeMap<&Names, BTreeSet<Names>> {
        let arrows = |module: &Names| {
            let used = self.used.get(module).into_iter().flatten().filter_map(|path| self.origin(path, 0));
            used.filter(|origin| !module.starts_with(origin)).collect()
        };
        self.modules.keys().map(|module| (module, arrows(module))).collect()
    }

    /// Groups of files each of which leads to each other.
    fn circles(&self) -> Vec<Vec<&str>> {
        let arrows = self.arrows().into_iter().map(|(module, uses)| (module.clone(), uses)).collect();
        let files = |circle: Vec<Names>| circle.iter().map(|module| self.modules[module].as_str()).collect();
        circles(&arrows).into_iter().map(files).collect()
    }

    /// Groups of rooms of a folder, each of which leads to each other, whatever file of a room it is that does.
    fn circles_of_rooms(&self) -> Vec<Vec<String>> {
        let arrows = self.arrows();
        let folders: BTreeSet<&[String]> =
            self.modules.keys().filter_map(|module| Some(module.split_last()?.1)).collect();
        let mut found = Vec::new();
        for folder in folders {
            let room = |module: &Names| {
                let room = module.get(..=folder.len()).filter(|room| room.starts_with(folder));
                room.map(<[String]>::to_vec)
            };
            let mut between: BTreeMap<Names, BTreeSet<Names>> = BTreeMap::new();
            for (module, uses) in &arrows {
                let Some(own) = room(module) else { continue };
                let others = uses.iter().filter_map(room).filter(|other| *other != own);
                between.entry(own.clone()).or_default().extend(others);
            }
            let shown = |circle: Vec<Names>| circle.iter().map(|room| room.join("/")).collect();
            found.extend(circles(&between).into_iter().map(shown));
        }
        found
    }
}

/// Groups of which each member leads to each other.
fn circles(arrows: &BTreeMap<Names, BTreeSet<Names>>) -> BTreeSet<Vec<Names>> {
    let reached = |from: &Names| {
        let mut reached: BTreeSet<&Names> = BTreeSet::new();
        let mut open: Vec<&Names> = arrows[from].iter().collect();
        while let Some(next) = open.pop() {
            if reached.insert(next) {
                open.extend(arrows.get(next).into_iter().flatten());
            }
        }
        reached
    };
    let reached: BTreeMap<&Names, BTreeSet<&Names>> = arrows.keys().map(|module| (module, reached(module))).collect();
    let mut circles = BTreeSet::new();
    for (module, beyond) in reached.iter().filter(|(module, beyond)| beyond.contains(*module)) {
        let both = |other: &&&Names| reached.get(**other).is_some_and(|back| back.contains(module));
        circles.insert(beyond.iter().filter(both).map(|other| (*other).clone()).collect::<Vec<_>>());
    }
    circles
}

/// Everything that has files which import each other, by its folder.
fn all() -> Vec<(&'static str, Crate)> {
    let crates = CRATES.iter().chain(&APART).map(|&(folder, ..)| folder);
    // The targets of the fuzzer are programs of one file each.
    let crates = crates.filter(|folder| *folder != "tests/fuzz").map(|folder| (folder, Crate::read(folder)));
    crates.chain([("client/python/python", scripts::python()), ("client/web/src", scripts::page())]).collect()
}

#[test]
fn imports_of_files_run_in_no_circle() {
    let mut broken = Vec::new();
    for (folder, files) in all() {
        for circle in files.circles() {
            broken.push(format!("{folder}: these files import each other in a circle: {}", circle.join(", ")));
        }
    }
    hold(&broken);
}

#[test]
fn imports_of_rooms_run_in_no_circle() {
    let mut broken = Vec::new();
    for (folder, files) in all() {
        for circle in files.circles_of_rooms() {
            broken.push(format!("{folder}: these rooms import each other in a circle: {}", circle.join(", ")));
        }
    }
    hold(&broken);
}

#[test]
fn a_circle_is_found_and_a_room_with_inner_rooms_is_none() {
    let crate_of = |files: &[(&str, &str)]| {
        Crate::of(files.iter().map(|&(module, code)| (module.to_owned(), format!("{module}.rs"), code.to_owned())))
    };
    let rooms = crate_of(&[
        ("lib", "pub mod a;\npub use a::inner::Inner;"),
        ("a", "mod inner;\nuse inner::Inner;\npub struct Outer;"),
        ("a/inner", "use super::Outer;\nuse crate::{\n    b::{self, B},\n    c::C as D,\n};"),
        ("b", "use crate::c::C;"),
        ("c", "use std::fmt;"),
    ]);
    assert!(rooms.circles().is_empty(), "{:?}", rooms.circles());
    let circle = crate_of(&[
        ("lib", "mod a;\nmod b;\nmod c;\npub use c::C;"),
        ("a", "use crate::b::B;"),
        ("b", "fn f() { crate::C::new(); }"),
        ("c", "use super::a;\nuse super::{a::A};"),
    ]);
    assert_eq!(circle.circles(), [["a.rs", "b.rs", "c.rs"]]);
    let rooms = crate_of(&[
        ("lib", "mod a;\nmod b;"),
        ("a", "pub mod one;\npub mod two;"),
        ("a/one", "use crate::b::three;"),
        ("a/two", "use std::fmt;"),
        ("b", "pub mod three;\npub mod four;"),
        ("b/three", "use std::fmt;"),
        ("b/four", "use crate::a::two;"),
    ]);
    assert!(rooms.circles().is_empty());
    assert_eq!(rooms.circles_of_rooms(), [["a", "b"]]);
}
