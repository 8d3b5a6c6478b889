//! The order of the modules (docs/ARCHITECTURE.md): data flows one way, and a module uses only
//! those before it in `src/lib.rs`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Modules that may not use what the order alone would let them.
const NEVER: [(&str, &[&str]); 2] = [
    // A checker that shares a kernel with what it checks proves nothing.
    ("verify", &["morph", "region", "access", "search", "planner"]),
    // Its engines know no manufacturing word.
    ("search", &["mesh", "voxel", "morph", "machine", "region", "access"]),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// The modules in the order of `src/lib.rs`.
fn order() -> Vec<String> {
    let lib = fs::read_to_string(root().join("src/lib.rs")).unwrap();
    lib.lines()
        .filter_map(|l| l.strip_prefix("pub mod ")?.strip_suffix(';'))
        .map(String::from)
        .collect()
}

fn sources(dir: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Code without comments and without what only tests see.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let lines = text.lines().map(|l| l.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

/// Names after `crate::`, those of a `crate::{a, b}` list included.
fn used(code: &str) -> BTreeSet<String> {
    let word = |s: &str| -> String {
        s.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect()
    };
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let Some(list) = rest.strip_prefix('{') else {
            found.insert(word(rest));
            continue;
        };
        let mut depth = 0;
        let mut item = String::new();
        for c in list.chars() {
            match c {
                '}' if depth == 0 => break,
                ',' if depth == 0 => {
                    found.insert(word(item.trim()));
                    item.clear();
                    continue;
                }
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            item.push(c);
        }
        found.insert(word(item.trim()));
    }
    found
}

/// Whether a file is compiled for tests alone.
fn is_test(path: &Path) -> bool {
    path.iter().any(|part| part == "tests")
        || path.file_stem().is_some_and(|s| {
            let s = s.to_string_lossy();
            s == "tests" || s.ends_with("_tests")
        })
}

#[test]
fn imports_point_one_way() {
    let order = order();
    let mut wrong = Vec::new();
    let mut seen = 0;
    for (i, module) in order.iter().enumerate() {
        let forbidden = NEVER.iter().find(|(m, _)| m == module).map_or(&[][..], |(_, f)| *f);
        for path in sources(&root().join("src").join(module)) {
            if is_test(&path) {
                continue;
            }
            for name in used(&code(&path)) {
                seen += 1;
                let later = order[i + 1..].contains(&name);
                if later || forbidden.contains(&name.as_str()) {
                    wrong.push(format!("{} uses {name}", path.display()));
                }
            }
        }
    }
    assert!(seen > 50, "only {seen} imports found: the reader of sources is broken");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_module_is_listed_and_nothing_uses_the_command_line() {
    let order = order();
    for entry in fs::read_dir(root().join("src")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let binary = ["cli", "main", "lib"].contains(&name.as_str());
        assert!(binary || order.contains(&name), "src/{name} is not in src/lib.rs");
    }
    let table = fs::read_to_string(root().join("docs/ARCHITECTURE.md")).unwrap();
    let listed: Vec<&str> = table
        .lines()
        .filter(|l| l.starts_with("| ") && l.contains(" | `"))
        .filter_map(|l| l.split('`').nth(1))
        .collect();
    assert_eq!(listed, order, "docs/ARCHITECTURE.md lists the modules in the order of src/lib.rs");
}

#[test]
fn the_top_level_holds_only_what_it_may() {
    let allowed = ["Cargo.toml", "Cargo.lock", "src", "tests", "fixtures", "docs", "README.md"];
    for entry in fs::read_dir(root()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        // `target` is never committed.
        let ours = allowed.contains(&name.as_str()) || name.starts_with('.') || name == "target";
        assert!(ours, "{name} does not belong at the top level");
    }
}

#[test]
fn the_reader_of_imports_reads_lists_and_paths() {
    let code = "use crate::base::{A, B};\nuse crate::{mesh::TriMesh, voxel::{x, y}, plan};\nlet a = crate::verify::f();";
    let names: Vec<String> = used(code).into_iter().collect();
    assert_eq!(names, ["base", "mesh", "plan", "verify", "voxel"]);
}
