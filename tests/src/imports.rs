//! The imports of a crate's files, read from their text: which module names which, tests left out.
//!
//! Enough of Rust's grammar for code that rustfmt has seen: `use` trees, and paths from `crate`, `super` and `self` in code. Macros that make
//! paths out of parts are not seen.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A module's path from the crate's root; empty for the root.
pub type Module = Vec<String>;

/// Module and name -> the module that it has the name from, by `pub use`.
type PassedOn = BTreeMap<(Module, String), Module>;

/// Modules of one crate and what each imports.
#[derive(Debug, Default)]
pub struct Imports {
    /// Module -> its file, from the crate's `src`.
    pub files: BTreeMap<Module, PathBuf>,
    /// Module -> modules whose items it names.
    pub edges: BTreeMap<Module, BTreeSet<Module>>,
}

impl Imports {
    /// Reads all files of a crate's `src` folder but those that only tests are made of.
    pub fn read(src: &Path) -> Imports {
        let mut files = BTreeMap::new();
        collect(src, src, &mut files);
        let texts: BTreeMap<Module, String> =
            files.iter().map(|(module, file)| (module.clone(), code_of(&fs::read_to_string(src.join(file)).unwrap()))).collect();
        let tests: BTreeSet<Module> = texts.iter().flat_map(|(module, text)| test_modules(module, text)).collect();
        files.retain(|module, _| !(1..=module.len()).any(|len| tests.contains(&module[..len])));
        let texts: BTreeMap<&Module, &String> = texts.iter().filter(|(module, _)| files.contains_key(*module)).collect();
        let mut passed_on = PassedOn::new();
        // What passes a name on may have it from a module that passes it on.
        for _ in 0..3 {
            for (module, text) in &texts {
                for path in paths(text, true) {
                    let (Some(to), Some(name)) = (resolve(&files, &passed_on, module, &path), path.last()) else { continue };
                    if to != **module {
                        passed_on.insert(((*module).clone(), name.clone()), to);
                    }
                }
            }
        }
        let mut edges = BTreeMap::new();
        for (module, text) in texts {
            let named = paths(text, false).into_iter().filter_map(|path| resolve(&files, &passed_on, module, &path));
            edges.insert(module.clone(), named.filter(|to| to != module && !to.is_empty()).collect());
        }
        Imports { files, edges }
    }

    /// The folder whose files belong together with a module's own: that of its children where it has any, else the one that it lies in.
    pub fn folder(&self, module: &Module) -> Module {
        let has_children = self.files.keys().any(|other| other.len() > module.len() && other.starts_with(module));
        if has_children || module.is_empty() { module.clone() } else { module[..module.len() - 1].to_vec() }
    }

    /// Modules that reach each other by imports, a list a circle.
    pub fn circles(&self) -> Vec<Vec<Module>> {
        let reached: BTreeMap<&Module, BTreeSet<&Module>> = self.files.keys().map(|from| (from, self.reached(from))).collect();
        let mut circles: Vec<Vec<Module>> = Vec::new();
        for from in self.files.keys() {
            let circle: Vec<Module> = reached[from]
                .iter()
                .filter(|to| reached.get(**to).is_some_and(|back| back.contains(from)))
                .map(|to| (*to).clone())
                .collect();
            if circle.len() > 1 && !circles.contains(&circle) {
                circles.push(circle);
            }
        }
        circles
    }

    fn reached<'a>(&'a self, from: &'a Module) -> BTreeSet<&'a Module> {
        let (mut reached, mut waiting) = (BTreeSet::new(), vec![from]);
        while let Some(module) = waiting.pop() {
            for to in self.edges.get(module).into_iter().flatten() {
                if reached.insert(to) {
                    waiting.push(to);
                }
            }
        }
        reached
    }
}

fn collect(src: &Path, folder: &Path, files: &mut BTreeMap<Module, PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(src, &path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let file = path.strip_prefix(src).unwrap().to_path_buf();
            let mut module: Module = file.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
            if module.last().is_some_and(|last| last == "mod") || ["lib", "main"].contains(&module[0].as_str()) {
                module.pop();
            }
            files.insert(module, file);
        }
    }
}

/// The text without comments and without modules of tests in it.
fn code_of(text: &str) -> String {
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    let text: String = lines.map(|line| line.split(" // ").next().unwrap_or_default().to_string() + "\n").collect();
    let (mut code, mut rest) = (String::new(), text.as_str());
    while let Some((before, after)) = rest.split_once("#[cfg(test)]\nmod tests {") {
        code.push_str(before);
        // rustfmt ends a module at the margin.
        rest = after.split_once("\n}\n").map_or("", |(_, rest)| rest);
    }
    code + rest
}

/// Modules that a file declares for tests alone.
fn test_modules(module: &Module, text: &str) -> Vec<Module> {
    let declared = text.split("#[cfg(test)]\n").skip(1).filter_map(|after| {
        let line = after.lines().next()?.trim_end().strip_suffix(';')?;
        line.rsplit_once("mod ").map(|(_, name)| name.to_string())
    });
    declared.map(|name| module.iter().cloned().chain([name]).collect()).collect()
}

/// Paths that a text names: the leaves of its `use` trees, and what begins with `crate`, `super` or `self` elsewhere. `public`: only what it
/// passes on by `pub use`.
fn paths(text: &str, public: bool) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let mut others = String::new();
    for (i, part) in text.split("use ").enumerate() {
        let line = others.rsplit('\n').next().unwrap_or_default();
        let (is_pub, is_use) = (line.trim_start().starts_with("pub"), i > 0 && (line.trim().is_empty() || line.ends_with([' ', ')'])));
        match part.split_once(';').filter(|_| is_use) {
            Some((tree, after)) => {
                if is_pub || !public {
                    leaves("", tree, &mut paths);
                }
                others.push_str(after);
            }
            None => others.push_str(part),
        }
    }
    if public {
        return paths;
    }
    for root in ["crate::", "super::", "self::"] {
        for (at, _) in others.match_indices(root) {
            let is_start = !others[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
            let end = others[at..].find(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')).map_or(others.len(), |len| at + len);
            if is_start {
                paths.push(segments(&others[at..end]));
            }
        }
    }
    paths
}

fn segments(path: &str) -> Vec<String> {
    let path = path.split(" as ").next().unwrap_or_default();
    path.split("::").map(|segment| segment.trim().to_string()).filter(|segment| !segment.is_empty()).collect()
}

/// The leaves of a `use` tree, each with its whole path.
fn leaves(prefix: &str, tree: &str, found: &mut Vec<Vec<String>>) {
    let Some(open) = tree.find('{') else {
        found.push(segments(&format!("{prefix}{tree}")));
        return;
    };
    let prefix = format!("{prefix}{}", tree[..open].trim());
    let inside = &tree[open + 1..tree.rfind('}').unwrap_or(tree.len())];
    let (mut depth, mut start) = (0, 0);
    for (at, c) in inside.char_indices().chain([(inside.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inside[start..at].trim().is_empty() {
                    leaves(&prefix, &inside[start..at], found);
                }
                start = at + 1;
            }
            _ => {}
        }
    }
}

/// The module that holds what a path names; `None` for paths out of the crate.
fn resolve(files: &BTreeMap<Module, PathBuf>, passed_on: &PassedOn, from: &Module, path: &[String]) -> Option<Module> {
    let mut path = path.iter().peekable();
    let mut module: Module = match path.peek()?.as_str() {
        "crate" => Vec::new(),
        "super" | "self" => from.clone(),
        child if files.contains_key(&[&from[..], &[child.to_string()]].concat()) => from.clone(),
        _ => return None,
    };
    while let Some(step) = path.next_if(|step| ["crate", "super", "self"].contains(&step.as_str())) {
        if step == "super" {
            module.pop()?;
        }
    }
    for segment in path {
        let child = [&module[..], std::slice::from_ref(segment)].concat();
        if !files.contains_key(&child) {
            module = passed_on.get(&(module.clone(), segment.clone())).cloned().unwrap_or(module);
            break;
        }
        module = child;
    }
    files.contains_key(&module).then_some(module)
}
