//! Rust sources as far as the rules need to understand them: code without comments, literals and tests.

use std::{
    path::{Path, PathBuf},
    sync::LazyLock,
};

/// A source file of the service.
pub struct Source {
    /// Its path below `src`, with `/`.
    pub path: String,
    /// As it is.
    pub text: String,
    /// The same with comments, the insides of literals and tests blanked; lines keep their numbers.
    pub code: String,
}

impl Source {
    /// A file of that text, wherever it comes from.
    pub fn new(path: &str, text: &str) -> Self {
        let code = without_tests(&without_comments_and_literals(text));
        Self { path: path.to_owned(), text: text.to_owned(), code }
    }

    /// Every file below `src` that is not a test; read once.
    pub fn all() -> &'static [Self] {
        static ALL: LazyLock<Vec<Source>> = LazyLock::new(Source::read);
        &ALL
    }

    fn read() -> Vec<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let mut tests = Vec::new();
        let mut sources = Vec::new();
        for entry in walkdir::WalkDir::new(&root).sort_by_file_name() {
            let entry = entry.expect("a readable source tree");
            if entry.path().extension().is_none_or(|extension| extension != "rs") {
                continue;
            }
            let path = entry.path().strip_prefix(&root).expect("below src").to_string_lossy().replace('\\', "/");
            let text = std::fs::read_to_string(entry.path()).expect("a source in UTF-8");
            tests.extend(test_modules(&path, &text));
            sources.push(Self::new(&path, &text));
        }
        sources.retain(|source| !tests.iter().any(|test| is_module_file(&source.path, test)));
        sources
    }

    /// True for a file in one of these folders, or of one of these names.
    pub fn is_in(&self, places: &[&str]) -> bool {
        places.iter().any(|place| self.path == *place || (place.ends_with('/') && self.path.starts_with(place)))
    }

    /// The lines, from 1, of the code that mention `name` as a whole: no letter, digit or `_` beside it.
    pub fn mentions(&self, name: &str) -> Vec<usize> {
        let bare = |text: Option<char>| text.is_none_or(|c| !c.is_alphanumeric() && c != '_');
        let hits = self.code.match_indices(name).filter(|(at, _)| {
            let (before, after) = (&self.code[..*at], &self.code[at + name.len()..]);
            bare(before.chars().next_back()) && bare(after.chars().next())
        });
        let mut lines: Vec<usize> = hits.map(|(at, _)| line_of(&self.code, at)).collect();
        lines.dedup();
        lines
    }

    /// The top modules of its package that it uses, with their lines: `crate::a`, `crate::{a, b::c}`, and `super::a`
    /// where `super` is the top.
    pub fn modules_used(&self) -> Vec<(usize, String)> {
        let mut used = Vec::new();
        for (at, _) in self.code.match_indices("crate::") {
            if !self.code[..at].ends_with(|c: char| c.is_alphanumeric() || matches!(c, '_' | '$')) {
                used.extend(names_after(&self.code, at + "crate::".len()));
            }
        }
        let depth = module_depth(&self.path);
        let mut at = 0;
        while let Some(found) = self.code[at..].find("super::") {
            let begin = at + found;
            let mut end = begin;
            let mut steps = 0;
            while self.code[end..].starts_with("super::") {
                (end, steps) = (end + "super::".len(), steps + 1);
            }
            if steps == depth {
                used.extend(names_after(&self.code, end));
            }
            at = end;
        }
        used
    }
}

/// The line, from 1, of byte `at`.
pub fn line_of(text: &str, at: usize) -> usize {
    text[..at].matches('\n').count() + 1
}

/// Modules between the file and the top of its package.
fn module_depth(path: &str) -> usize {
    let parts = path.split('/').count();
    match path.rsplit('/').next() {
        Some("mod.rs") => parts - 1,
        Some("lib.rs" | "main.rs") if parts == 1 => 0,
        _ => parts,
    }
}

/// The first name of each path at `at`: one, or those of a group in braces.
fn names_after(code: &str, at: usize) -> Vec<(usize, String)> {
    let name_at = |at: usize| {
        let name: String = code[at..].chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        (!name.is_empty()).then(|| (line_of(code, at), name))
    };
    if !code[at..].starts_with('{') {
        return name_at(at).into_iter().collect();
    }
    let mut names = Vec::new();
    let (mut depth, mut expects_name) = (0, false);
    for (offset, c) in code[at..].char_indices() {
        match c {
            '{' => (depth, expects_name) = (depth + 1, depth == 0),
            '}' if depth == 1 => break,
            '}' => depth -= 1,
            ',' => expects_name = depth == 1,
            c if c.is_whitespace() => {}
            _ if expects_name => {
                names.extend(name_at(at + offset));
                expects_name = false;
            }
            _ => {}
        }
    }
    names
}

/// The modules that a file declares for tests alone, as paths below `src` without `.rs`.
fn test_modules(path: &str, text: &str) -> Vec<PathBuf> {
    let folder = match path.rsplit_once('/') {
        Some((folder, "mod.rs" | "lib.rs" | "main.rs")) => PathBuf::from(folder),
        _ if path.ends_with("lib.rs") || path.ends_with("main.rs") => PathBuf::new(),
        _ => PathBuf::from(path.trim_end_matches(".rs")),
    };
    let declared = text.split("#[cfg(test)]").skip(1).filter_map(|rest| {
        let rest = rest.trim_start();
        if let Some(rest) = rest.strip_prefix("#[path = \"") {
            // relative to the folder of the file, not to that of its modules
            let (file, _) = rest.split_once(".rs\"")?;
            return Some(Path::new(path).parent().unwrap_or(Path::new("")).join(file));
        }
        let rest = rest.strip_prefix("pub(crate) ").or_else(|| rest.strip_prefix("pub(super) ")).unwrap_or(rest);
        let (name, _) = rest.strip_prefix("mod ")?.split_once(';')?;
        (!name.contains(['{', '}'])).then(|| folder.join(name.trim()))
    });
    declared.collect()
}

fn is_module_file(path: &str, module: &Path) -> bool {
    let file = Path::new(path);
    file.with_extension("") == module || file.starts_with(module)
}

/// Blanks comments and what stands between the quotes of strings and characters.
pub fn without_comments_and_literals(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let length = hidden(rest).unwrap_or(0);
        if length == 0 {
            code.push(c);
            rest = &rest[c.len_utf8()..];
            // a raw string or a byte string begins with a letter that is no name
            if c.is_alphanumeric() || c == '_' {
                let name = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
                code.push_str(&rest[..name]);
                rest = &rest[name..];
            }
            continue;
        }
        code.extend(rest[..length].chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        rest = &rest[length..];
    }
    code
}

/// The length of the comment or literal that `text` begins with.
fn hidden(text: &str) -> Option<usize> {
    if text.starts_with("//") {
        return Some(text.find('\n').unwrap_or(text.len()));
    }
    if text.starts_with("/*") {
        return Some(text.find("*/").map_or(text.len(), |end| end + 2));
    }
    let body = text.strip_prefix('b').unwrap_or(text);
    let prefix = text.len() - body.len();
    if let Some(raw) = body.strip_prefix('r') {
        let hashes = raw.len() - raw.trim_start_matches('#').len();
        if raw[hashes..].starts_with('"') {
            let close = format!("\"{}", "#".repeat(hashes));
            let begin = prefix + 1 + hashes + 1;
            return Some(text[begin..].find(&close).map_or(text.len(), |end| begin + end + close.len()));
        }
    }
    if let Some(string) = body.strip_prefix('"') {
        return Some(prefix + 1 + quoted(string, '"'));
    }
    let character = body.strip_prefix('\'')?;
    let is_escape = character.starts_with('\\');
    // 'a is a lifetime, 'a' a character
    let closed = character.chars().nth(1) == Some('\'');
    (is_escape || closed).then(|| prefix + 1 + quoted(character, '\''))
}

/// The length up to and with the closing quote.
fn quoted(text: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            c if c == quote => return at + 1,
            _ => {}
        }
    }
    text.len()
}

/// Blanks every item under `#[cfg(test)]`; `code` has no comments and literals any more.
fn without_tests(code: &str) -> String {
    let mut kept = String::with_capacity(code.len());
    let mut rest = code;
    while let Some(at) = rest.find("#[cfg(test)]") {
        kept.push_str(&rest[..at]);
        let item = &rest[at..];
        let end = item_end(item);
        kept.extend(item[..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        rest = &item[end..];
    }
    kept + rest
}

/// Where the item that `code` begins with ends: at its `;`, or at the brace that closes its first.
fn item_end(code: &str) -> usize {
    let mut depth = 0;
    for (at, c) in code.char_indices() {
        match c {
            ';' if depth == 0 => return at + 1,
            '{' => depth += 1,
            '}' if depth == 1 => return at + 1,
            '}' => depth -= 1,
            _ => {}
        }
    }
    code.len()
}
