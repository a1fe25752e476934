# Thin names for the commands; `just` lists them.

_default:
    @just --list

# what the README calls the tests
test *arguments:
    cargo test --workspace {{arguments}}

# formatting and lints
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets -- -D warnings

# a service with a synthetic station on http://127.0.0.1:8080/
demo:
    cargo run --release -- serve --demo

# writes the contract that the code has now
openapi:
    cargo run --quiet -- openapi > openapi/firn.json

# the contract test: schemathesis against a real server
contract *arguments:
    tests/contract/run {{arguments}}

# timings
bench *arguments:
    cargo bench --workspace {{arguments}}

# everything that must hold before a merge
ci:
    bash .ci/run
