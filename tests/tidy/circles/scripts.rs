//! The imports of the files of the Python package and of the page, which are no Rust.
//!
//! Invariant: what is read are `import` declarations that name a file of the same folder; a package or a generated file
//! is not one of them.

use super::{Crate, Names};
use crate::{files, read};

/// The Python package: a module for each file. `__init__.py` exports all that it imports.
pub(super) fn python() -> Crate {
    const FOLDER: &str = "client/python/python/tidemap/";
    let module = |path: &str| {
        let name = path.trim_start_matches(FOLDER).trim_end_matches(".py");
        names(name.strip_suffix("__init__").unwrap_or(name))
    };
    modules(files(FOLDER, ".py").into_iter().map(|path| {
        let module = module(&path);
        let used = python_imports(&read(&path));
        (module, path, used)
    }))
}

/// The page: a module for each file of TypeScript and for each component.
pub(super) fn page() -> Crate {
    const FOLDER: &str = "client/web/src/";
    let all: Vec<String> = files(FOLDER, ".ts").into_iter().chain(files(FOLDER, ".svelte")).collect();
    let module = |path: &str| names(path.trim_start_matches(FOLDER));
    let known: Vec<Names> = all.iter().map(|path| module(path)).collect();
    modules(all.into_iter().map(|path| {
        let module = module(&path);
        let text = read(&path);
        let used = page_imports(&text).into_iter().filter_map(|path| resolved(&module, path, &known)).collect();
        (module, path, used)
    }))
}

fn modules(files: impl IntoIterator<Item = (Names, String, Vec<Names>)>) -> Crate {
    let mut all = Crate::default();
    for (module, path, used) in files {
        if module.is_empty() {
            let exported = all.public.entry(module.clone()).or_default();
            exported.extend(used.into_iter().filter_map(|path| Some((path.last()?.clone(), path.clone()))));
        } else {
            all.used.insert(module.clone(), used);
        }
        all.modules.insert(module, path);
    }
    all
}

fn names(path: &str) -> Names {
    path.split('/').filter(|name| !name.is_empty()).map(str::to_owned).collect()
}

/// The names that a Python file imports of the package: modules, and names of modules.
fn python_imports(text: &str) -> Vec<Names> {
    let mut found = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while let Some(line) = lines.next() {
        let (module, list) = match line.split_once(" import ") {
            Some((from, list)) => (from.strip_prefix("from "), list),
            None => (line.strip_prefix("import "), ""),
        };
        let Some(module) = module.and_then(|module| module.strip_prefix("tidemap")) else { continue };
        let mut list = list.to_owned();
        while list.starts_with('(') && !list.contains(')') {
            let Some(more) = lines.next() else { break };
            list.push_str(more);
        }
        let list = list.trim_start_matches('(').split(')').next().unwrap_or_default();
        let module: Names = module.split('.').filter(|name| !name.is_empty()).map(str::to_owned).collect();
        let items = list.split(',').filter_map(|item| item.split_whitespace().next());
        let before = found.len();
        found.extend(items.map(|item| [&module[..], &[item.to_owned()]].concat()));
        if found.len() == before {
            found.push(module);
        }
    }
    found
}

/// The relative paths that a file of the page imports.
fn page_imports(text: &str) -> Vec<&str> {
    let quoted = text.split(['\'', '"']).skip(1).step_by(2);
    let before = text.split(['\'', '"']).step_by(2);
    let is_import = |before: &str| {
        let last = before.trim_end();
        last.ends_with("from") || last.ends_with("import") || last.ends_with("import(")
    };
    before
        .zip(quoted)
        .filter(|(before, path)| is_import(before) && path.starts_with('.'))
        .map(|(_, path)| path)
        .collect()
}

/// The file that a relative path names, as seen from a file.
fn resolved(from: &[String], path: &str, known: &[Names]) -> Option<Names> {
    let mut found = from.split_last()?.1.to_vec();
    for name in path.split('/') {
        match name {
            "." => {}
            ".." => drop(found.pop()?),
            name => found.push(name.to_owned()),
        }
    }
    let name = found.pop()?;
    let with = |ending: &str| [&found[..], &[format!("{name}{ending}")]].concat();
    ["", ".ts"].map(with).into_iter().find(|path| known.contains(path))
}

#[test]
fn imports_of_scripts_are_read() {
    let python = "import json\nfrom tidemap import times as _times\nfrom tidemap.errors import (\n    A,\n    B as C,\n)\n\
                  from tidemap.client import Client\nimport tidemap.daemon\n";
    let found: Vec<String> = python_imports(python).iter().map(|names| names.join(".")).collect();
    assert_eq!(found, ["times", "errors.A", "errors.B", "client.Client", "daemon"]);

    let page = "import './page.css';\nimport type { A } from '../lib/a';\nexport { b } from \"./b.svelte\";\n\
                const text = './c';\nimport x from 'uplot';\nconst d = await import('./d');";
    assert_eq!(page_imports(page), ["./page.css", "../lib/a", "./b.svelte", "./d"]);
    let known = ["lib/a.ts", "parts/b.svelte", "parts/d.svelte.ts"].map(names);
    let from = names("parts/z.svelte");
    let found = ["../lib/a", "./b.svelte", "./d.svelte", "./page.css"].map(|path| resolved(&from, path, &known));
    assert_eq!(found, [Some(known[0].clone()), Some(known[1].clone()), Some(known[2].clone()), None]);

    let circle = modules([
        (names(""), "__init__.py".to_owned(), vec![names("a/A"), names("b/B")]),
        (names("a"), "a.py".to_owned(), vec![names("B")]),
        (names("b"), "b.py".to_owned(), vec![names("a/A")]),
        (names("c"), "c.py".to_owned(), vec![names("a")]),
    ]);
    assert_eq!(circle.circles(), [["a.py", "b.py"]]);
}

#[test]
fn the_scripts_are_found() {
    assert!(python().modules.len() > 4 && page().modules.len() > 20);
    assert!(page().arrows().values().map(std::collections::BTreeSet::len).sum::<usize>() > 40);
    assert!(python().arrows().values().map(std::collections::BTreeSet::len).sum::<usize>() > 4);
}
