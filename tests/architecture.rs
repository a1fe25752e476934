//! The invariants of `src/README.md` that a program can see. Each rule says what to do where it is broken, and is itself
//! tested on a snippet that breaks it.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

#[path = "architecture/source.rs"]
mod source;

use std::{path::Path, process::Command};

use source::{Source, line_of};

/// Where a rule is broken, and how.
type Faults = Vec<String>;

fn fault(source: &Source, line: usize, what: &str) -> String {
    format!("src/{}:{line}: {what}", source.path)
}

/// Fails with all faults of all sources, and what to do about them.
fn check(advice: &str, rule: impl Fn(&Source) -> Faults) {
    let sources = Source::all();
    assert!(sources.len() > 50, "the sources were not found");
    let faults: Faults = sources.iter().flat_map(rule).collect();
    assert!(faults.is_empty(), "{advice}\n{}", faults.join("\n"));
}

/// The names that a file must not mention.
fn forbidden(source: &Source, names: &[&str]) -> Faults {
    let hits = |name: &&str| -> Faults {
        source.mentions(name).into_iter().map(|line| fault(source, line, &format!("mentions `{name}`"))).collect()
    };
    names.iter().flat_map(hits).collect()
}

// ---- science is pure

const IMPURE: [&str; 17] = [
    "tokio",
    "sqlx",
    "axum",
    "reqwest",
    "hyper",
    "tracing",
    "SystemTime",
    "Instant",
    "Timestamp",
    "Zoned",
    "std::fs",
    "std::net",
    "std::env",
    "std::process",
    "std::io",
    "println",
    "thread_rng",
];

fn science_is_pure(source: &Source) -> Faults {
    if source.is_in(&["science/"]) { forbidden(source, &IMPURE) } else { Vec::new() }
}

#[test]
fn science_has_no_async_sql_http_files_or_clock() {
    let advice = "Science is pure functions of their arguments: read files, the clock and the database in `jobs` or `store` \
                  and hand the values in; randomness is a seed.";
    check(advice, science_is_pure);
    let bad = Source::new("science/forecast/x.rs", "fn f() { std::fs::read(\"x\"); }\nuse tokio::spawn;");
    assert_eq!(science_is_pure(&bad).len(), 2);
    let good = Source::new("science/forecast/x.rs", "// tokio\nfn f() { let tokio_like = \"tokio\"; }");
    assert_eq!(science_is_pure(&good), Faults::new());
}

fn impure_dependencies(manifest: &str) -> Faults {
    let dependencies = manifest.split("[dependencies]").nth(1).unwrap_or_default();
    let dependencies = dependencies.split("\n[").next().unwrap_or_default();
    let names = dependencies.lines().filter_map(|line| line.split(['=', '.']).next()).map(str::trim);
    names.filter(|name| IMPURE.contains(name) || name.starts_with("firn")).map(str::to_owned).collect()
}

#[test]
fn science_depends_on_nothing_impure() {
    let manifest = include_str!("../src/science/Cargo.toml");
    assert!(manifest.contains("[dependencies]"));
    assert_eq!(impure_dependencies(manifest), Faults::new(), "what science needs of these belongs into the service");
    assert_eq!(
        impure_dependencies("[dependencies]\nserde = \"1\"\ntokio.workspace = true\n[dev-dependencies]\nsqlx = 1"),
        ["tokio"]
    );
}

// ---- SQL, HTTP and time have one home each

fn sql_outside_the_store(source: &Source) -> Faults {
    if source.is_in(&["store/"]) {
        return Vec::new();
    }
    let mut faults = forbidden(source, &["sqlx"]);
    for statement in ["SELECT ", "INSERT INTO ", "DELETE FROM ", "PRAGMA ", "BEGIN IMMEDIATE"] {
        let hits = source.text.match_indices(statement);
        faults.extend(hits.map(|(at, _)| fault(source, line_of(&source.text, at), &format!("has SQL: {statement}"))));
    }
    faults
}

#[test]
fn sql_stands_only_in_the_store() {
    check("Give `store` a method with a name of the domain and call that.", sql_outside_the_store);
    let bad = Source::new("api/x.rs", "use sqlx::query;\nconst Q: &str = \"SELECT * FROM job\";");
    assert_eq!(sql_outside_the_store(&bad).len(), 2);
    assert_eq!(sql_outside_the_store(&Source::new("store/x.rs", "use sqlx::query;")).len(), 0);
}

fn http_outside_the_api(source: &Source) -> Faults {
    const HTTP: [&str; 7] = ["axum", "hyper", "http", "tower", "tower_http", "utoipa_axum", "reqwest"];
    if source.is_in(&["api/", "web/", "server.rs"]) { Vec::new() } else { forbidden(source, &HTTP) }
}

#[test]
fn http_stands_only_in_api_web_and_the_server() {
    let advice = "Return a value or a `domain::problem::Problem`; `api` alone turns it into HTTP.";
    check(advice, http_outside_the_api);
    let bad = Source::new("jobs/x.rs", "use axum::http::StatusCode;");
    assert_eq!(http_outside_the_api(&bad).len(), 2);
    assert_eq!(http_outside_the_api(&Source::new("jobs/x.rs", "const A: &str = \"http://axum\";")), Faults::new());
}

fn clock_read_elsewhere(source: &Source) -> Faults {
    const CLOCK: [&str; 5] = ["Timestamp::now", "Zoned::now", "SystemTime", "UtcDateTime", "now_v7"];
    match source.path.as_str() {
        "clock.rs" => Vec::new(),
        // an id is ordered by the time at which it is made
        "domain/ids.rs" => forbidden(source, &CLOCK[..4]),
        _ => forbidden(source, &CLOCK),
    }
}

#[test]
fn the_time_of_day_is_read_only_in_clock() {
    check("Ask `clock::now()`, or better take the instant as an argument.", clock_read_elsewhere);
    let bad = Source::new("store/x.rs", "let at = jiff::Timestamp::now();\nlet id = Uuid::now_v7();");
    assert_eq!(clock_read_elsewhere(&bad).len(), 2);
    assert_eq!(clock_read_elsewhere(&Source::new("domain/ids.rs", "Uuid::now_v7()")), Faults::new());
}

// ---- arrows between the folders

/// Folder, and the top modules that it must not use.
const ARROWS: [(&str, &[&str]); 5] = [
    ("domain/", &["store", "jobs", "api", "web", "formats", "server", "config", "demo", "clock"]),
    ("formats/", &["store", "jobs", "api", "web", "server", "config", "demo", "clock"]),
    ("store/", &["jobs", "api", "web", "formats", "server", "config", "demo"]),
    ("jobs/", &["api", "web", "server", "config", "demo"]),
    ("web/", &["jobs", "store", "formats", "server", "demo"]),
];

fn against_the_arrows(source: &Source) -> Faults {
    let Some((_, closed)) = ARROWS.iter().find(|(folder, _)| source.is_in(&[folder])) else { return Vec::new() };
    let used = source.modules_used().into_iter().filter(|(_, module)| closed.contains(&module.as_str()));
    used.map(|(line, module)| fault(source, line, &format!("uses `{module}`"))).collect()
}

#[test]
fn arrows_between_folders_point_one_way() {
    let advice = "api, web -> jobs, store, formats -> domain, science: move what is shared to the inner folder, or hand a \
                  value in from the outer one.";
    check(advice, against_the_arrows);
    let bad =
        "use crate::{\n    clock,\n    store::{Store, jobs::Outcome},\n};\nuse super::super::api::x;\nuse super::jobs;";
    assert_eq!(
        against_the_arrows(&Source::new("domain/x.rs", bad)),
        ["src/domain/x.rs:2: uses `clock`", "src/domain/x.rs:3: uses `store`", "src/domain/x.rs:5: uses `api`"]
    );
    // super is the top only one step below it
    assert_eq!(against_the_arrows(&Source::new("domain/mod.rs", "use super::store::Store;")).len(), 1);
    assert_eq!(against_the_arrows(&Source::new("store/models.rs", "use super::jobs::finish;")), Faults::new());
}

// ---- the state of a job

fn states_written_by_hand(source: &Source) -> Faults {
    let mut faults = Vec::new();
    for state in ["running", "successful", "failed", "dismissed"] {
        let literal = format!("'{state}'");
        for (at, _) in source.text.match_indices(&literal) {
            let before = &source.text[..at];
            let condition =
                before.rfind("WHERE").max(before.rfind(" IN (")) > before.rfind("SET ").max(before.rfind("VALUES"));
            if !condition && source.is_in(&["store/"]) {
                faults.push(fault(source, line_of(&source.text, at), &format!("writes the state {literal}")));
            }
        }
    }
    for state in ["Running", "Successful", "Failed", "Dismissed"] {
        let lines = source.mentions(&format!("status: Status::{state}"));
        faults.extend(lines.into_iter().map(|line| fault(source, line, &format!("sets the state {state}"))));
    }
    for (at, _) in source.code.match_indices(".status = ") {
        faults.push(fault(source, line_of(&source.code, at), "sets a state"));
    }
    for (at, body) in functions(&source.text) {
        if body.contains("UPDATE job SET status") && !body.contains("step(") {
            faults.push(fault(source, line_of(&source.text, at), "changes a state without asking `step`"));
        }
    }
    if source.path == "domain/job.rs" { Vec::new() } else { faults }
}

/// Each function with where it begins: from its `fn` to the next one.
fn functions(text: &str) -> Vec<(usize, &str)> {
    let begins: Vec<usize> = text.match_indices("fn ").map(|(at, _)| at).collect();
    let ends = begins.iter().skip(1).copied().chain([text.len()]);
    begins.iter().copied().zip(ends).map(|(begin, end)| (begin, &text[begin..end])).collect()
}

#[test]
fn a_job_changes_its_state_only_through_its_state_machine() {
    let advice =
        "Ask `domain::job::Status::after` through `step` in the transaction, and bind the state that it gives.";
    check(advice, states_written_by_hand);
    let store = |body: &str| states_written_by_hand(&Source::new("store/jobs.rs", body));
    assert_eq!(store("fn f() { q(\"UPDATE job SET status = 'running' WHERE id = ?\") }").len(), 2);
    assert_eq!(store("fn f() { q(\"UPDATE job SET status = ?2 WHERE id = ?1\") }").len(), 1);
    assert_eq!(store("fn f() { step(); q(\"UPDATE job SET status = ?2 WHERE id = ?1\") }"), Faults::new());
    assert_eq!(store("fn f() { q(\"UPDATE job SET phase = ? WHERE id = ? AND status = 'running'\") }"), Faults::new());
    assert_eq!(store("fn f() { q(\"INSERT INTO job (status) VALUES ('failed')\") }").len(), 1);
    let runner = |body: &str| states_written_by_hand(&Source::new("jobs/runner.rs", body));
    assert_eq!(runner("let job = Job { status: Status::Running, ..job };").len(), 1);
    assert_eq!(runner("job.status = after;").len(), 1);
    assert_eq!(runner("if job.status == Status::Running {}"), Faults::new());
    // the check would be idle if the store said it in other words
    let jobs = Source::all().iter().filter(|source| source.path.starts_with("store/jobs/"));
    let writes =
        jobs.flat_map(|source| functions(&source.text)).filter(|(_, body)| body.contains("UPDATE job SET status"));
    assert!(writes.count() >= 3);
}

// ---- nothing gives up half-way

fn gives_up(source: &Source) -> Faults {
    let raw: Vec<&str> = source.text.lines().collect();
    let mut faults = Vec::new();
    for (at, line) in source.code.lines().enumerate() {
        let is_whole = |at: usize| line[at..].starts_with('.') || !line[..at].ends_with(char::is_alphanumeric);
        let words = [".unwrap()", ".expect(", "panic!(", "todo!(", "unimplemented!(", "unreachable!("];
        let found = words.into_iter().find(|word| line.match_indices(word).any(|(at, _)| is_whole(at)));
        let Some(word) = found else { continue };
        let above = &raw[at.saturating_sub(12)..=at];
        let excused = above.iter().any(|line| line.contains("expect(clippy::") || line.contains("clippy::expect_used"));
        if !excused || word.starts_with("todo") || word.starts_with("unimplemented") {
            faults.push(fault(source, at + 1, word));
        }
    }
    faults
}

#[test]
fn nothing_outside_of_tests_unwraps_or_is_left_to_do() {
    let advice = "Return an error; where it cannot happen, prove it in `#[expect(clippy::..., reason = \"...\")]`.";
    check(advice, gives_up);
    assert_eq!(gives_up(&Source::new("x.rs", "fn f() { a.unwrap(); }\nfn g() { todo!() }")).len(), 2);
    let proven = "#[expect(clippy::expect_used, reason = \"a constant\")]\nfn f() { a.expect(\"x\"); }";
    assert_eq!(gives_up(&Source::new("x.rs", proven)), Faults::new());
    let test = "#[cfg(test)]\nmod tests {\n    fn f() { a.unwrap(); }\n}\nfn g() { b.unwrap_or(1); }";
    assert_eq!(gives_up(&Source::new("x.rs", test)), Faults::new());
}

// ---- files that can be read in one sitting

/// Files that may be longer, and why.
const LONG_FILES: [(&str, &str); 0] = [];

fn too_long(source: &Source) -> Faults {
    const LONGEST: usize = 600;
    let lines = source.text.lines().count();
    let listed = LONG_FILES.iter().any(|(path, reason)| *path == source.path && !reason.is_empty());
    if lines > LONGEST && !listed {
        vec![fault(source, lines, &format!("has more than {LONGEST} lines"))]
    } else {
        Vec::new()
    }
}

#[test]
fn no_file_grows_beyond_reading() {
    check("Split it by what it knows; or list it in LONG_FILES with the reason.", too_long);
    assert_eq!(too_long(&Source::new("x.rs", &"\n".repeat(601))).len(), 1);
    assert_eq!(too_long(&Source::new("x.rs", &"\n".repeat(600))), Faults::new());
}

// ---- what must not stand in any file of the repository

/// Texts that tie the project to one machine or one registry; joined here, so that this file is not a fault itself.
const TIED: [&str; 12] = [
    concat!("/ro", "ot/"),
    concat!("/ho", "me/"),
    concat!("/Us", "ers/"),
    concat!("/wo", "rk/"),
    concat!("/t", "mp/wt"),
    concat!("crates", ".io"),
    concat!("pypi", ".org"),
    concat!("python", "hosted.org"),
    concat!("npmjs", ".org"),
    concat!("npmjs", ".com"),
    concat!("docker", ".io"),
    concat!("ghcr", ".io"),
];

/// Registries as cargo writes them into its lock file, whatever machine it runs on.
const LOCK_FILE_SOURCE: &str = concat!("registry+https://github.com/rust-lang/crates", ".io-index");

fn tied_to_a_machine(path: &str, text: &str) -> Faults {
    let text = if path == "Cargo.lock" { text.replace(LOCK_FILE_SOURCE, "") } else { text.to_owned() };
    let lines = text.lines().enumerate();
    let found = lines.filter_map(|(at, line)| Some((at + 1, TIED.iter().find(|tie| line.contains(*tie))?)));
    found.map(|(line, tie)| format!("{path}:{line}: names {tie}")).collect()
}

/// The tracked files; in a copy without git, all that git would track.
fn repository_files() -> Vec<String> {
    let root = env!("CARGO_MANIFEST_DIR");
    let listed = Command::new("git").args(["ls-files", "-z"]).current_dir(root).output();
    if let Ok(listed) = listed
        && listed.status.success()
        && !listed.stdout.is_empty()
    {
        let text = String::from_utf8(listed.stdout).expect("paths in UTF-8");
        return text.split('\0').filter(|path| !path.is_empty()).map(str::to_owned).collect();
    }
    let ignored = ["target", ".git", ".venv", "node_modules", "__pycache__", "firn-data"];
    let walk = walkdir::WalkDir::new(root).into_iter();
    let kept = walk.filter_entry(|entry| !ignored.contains(&entry.file_name().to_string_lossy().as_ref()));
    let files = kept.filter_map(Result::ok).filter(|entry| entry.file_type().is_file());
    files.map(|entry| entry.path().strip_prefix(root).expect("below").to_string_lossy().into_owned()).collect()
}

#[test]
fn no_file_names_a_machine_or_a_registry() {
    let files = repository_files();
    assert!(files.iter().any(|path| path == "Cargo.toml"), "{files:?}");
    let mut faults = Faults::new();
    for path in files {
        // what is no text, or was just removed, names nothing
        if let Ok(text) = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(&path)) {
            faults.extend(tied_to_a_machine(&path, &text));
        }
    }
    let advice = "Say it relative to the repository, or leave the registry to the tool's own settings.";
    assert!(faults.is_empty(), "{advice}\n{}", faults.join("\n"));
    assert_eq!(tied_to_a_machine("x.md", &format!("a\nsee {}someone/x", TIED[1])).len(), 1);
    assert_eq!(tied_to_a_machine("Cargo.lock", &format!("source = \"{LOCK_FILE_SOURCE}\"")), Faults::new());
    assert_eq!(tied_to_a_machine("Cargo.toml", LOCK_FILE_SOURCE).len(), 1);
}

// ---- every refusal is a problem

fn answers_without_a_problem(source: &Source) -> Faults {
    if !source.is_in(&["api/"]) || source.is_in(&["api/problem.rs"]) {
        return Vec::new();
    }
    let names = [
        "BAD_REQUEST",
        "NOT_FOUND",
        "FORBIDDEN",
        "UNAUTHORIZED",
        "CONFLICT",
        "UNPROCESSABLE_ENTITY",
        "INTERNAL_SERVER_ERROR",
        "SERVICE_UNAVAILABLE",
        "PRECONDITION_FAILED",
    ];
    let mut faults = forbidden(source, &names.map(|name| format!("StatusCode::{name}")).each_ref().map(String::as_str));
    // axum's own extractors refuse in plain text
    faults.extend(forbidden(source, &["axum::extract::Path", "axum::extract::Query", "axum::extract::Json"]));
    faults
}

#[test]
fn refusals_are_made_of_problems_alone() {
    let advice = "Return `domain::problem::Problem`, whose code has the status; extract with `api::extract`.";
    check(advice, answers_without_a_problem);
    let bad = Source::new("api/x.rs", "return StatusCode::NOT_FOUND.into_response();");
    assert_eq!(answers_without_a_problem(&bad).len(), 1);
}

// ---- the reader of sources

#[test]
fn sources_are_read_as_rust_is_written() {
    let text = "let a = 'x'; let b: &'static str = \"tokio // no\"; // tokio\nlet r = br#\"tokio \" \"#; /* tokio\n */ let c = '\\'';\n#[cfg(test)]\nfn f() { tokio(); }\nuse tokio;";
    let source = Source::new("x.rs", text);
    assert_eq!(source.mentions("tokio"), [6]);
    assert_eq!(source.code.lines().count(), text.lines().count());
    assert!(source.code.contains("'static str"), "{}", source.code);
    let tests: Vec<&str> =
        Source::all().iter().map(|source| source.path.as_str()).filter(|path| path.ends_with("tests.rs")).collect();
    assert!(tests.is_empty(), "test modules are left out, but {tests:?} are not");
}
