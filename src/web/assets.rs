//! The files of the pages, compiled into the binary, each with its media type and entity tag.

use std::{
    collections::HashMap,
    sync::{Arc, LazyLock},
};

use axum::http::HeaderValue;
use utoipa_swagger_ui::Config;

use crate::api::extract::etag;

/// Media type of a page.
pub const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// A file as it is served.
#[derive(Clone)]
pub struct Asset {
    /// Media type, from the end of its name.
    pub media_type: &'static str,
    /// Strong entity tag.
    pub tag: HeaderValue,
    /// Content.
    pub bytes: &'static [u8],
}

/// Lists files of `src/web/assets` by their names.
macro_rules! files {
    ($($name:literal,)+) => {
        &[$(($name, include_bytes!(concat!("assets/", $name)) as &[u8]),)+]
    };
}

/// Our own files.
const OWN: &[(&str, &[u8])] = files![
    "index.html",
    "station.html",
    "docs.html",
    "base.css",
    "firn.css",
    "docs.css",
    "icon.svg",
    "api.js",
    "dom.js",
    "text.js",
    "key.js",
    "home.js",
    "jobs.js",
    "forecast.js",
    "station.js",
    "model.js",
    "observations.js",
    "season.js",
    "similar.js",
    "chart.js",
    "docs.js",
];

/// Prefix of the files of Swagger UI.
const READER: &str = "swagger-ui/";

/// The two of its files that our page needs.
const READER_FILES: [&str; 2] = ["swagger-ui.css", "swagger-ui-bundle.js"];

static ALL: LazyLock<HashMap<String, Asset>> = LazyLock::new(|| {
    let own = OWN.iter().map(|(name, bytes)| ((*name).to_owned(), *bytes));
    let reader = READER_FILES.iter().filter_map(|name| Some((format!("{READER}{name}"), reader_file(name)?)));
    own.chain(reader)
        .filter_map(|(name, bytes)| {
            let asset = asset(&name, bytes)?;
            Some((name, asset))
        })
        .collect()
});

/// The file of that name, such as `firn.css` or `swagger-ui/swagger-ui.css`.
pub fn find(name: &str) -> Option<Asset> {
    ALL.get(name).cloned()
}

fn asset(name: &str, bytes: &'static [u8]) -> Option<Asset> {
    Some(Asset { media_type: media_type(name)?, tag: etag(bytes), bytes })
}

fn media_type(name: &str) -> Option<&'static str> {
    match name.rsplit_once('.')?.1 {
        "html" => Some(HTML),
        "css" => Some(CSS),
        "js" => Some(SCRIPT),
        "svg" => Some(SVG),
        _ => None,
    }
}

/// A file of Swagger UI; the crate hands these two out as they are, compiled in.
fn reader_file(name: &str) -> Option<&'static [u8]> {
    let file = utoipa_swagger_ui::serve(name, Arc::new(Config::from("/openapi.json"))).ok()??;
    Some(match file.bytes {
        std::borrow::Cow::Borrowed(bytes) => bytes,
        std::borrow::Cow::Owned(bytes) => bytes.leak(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_is_there_with_a_media_type() {
        for name in
            OWN.iter().map(|(name, _)| (*name).to_owned()).chain(READER_FILES.map(|name| format!("{READER}{name}")))
        {
            let asset = find(&name).unwrap_or_else(|| panic!("{name} is not served"));
            assert!(!asset.bytes.is_empty(), "{name} is empty");
        }
    }

    #[test]
    fn every_file_of_the_folder_is_listed() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/web/assets");
        let mut there: Vec<String> =
            std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
        let mut listed: Vec<String> = OWN.iter().map(|(name, _)| (*name).to_owned()).collect();
        there.sort();
        listed.sort();
        assert_eq!(there, listed);
    }

    #[test]
    fn our_files_name_no_other_host() {
        // the name of the SVG namespace is an identifier: nobody fetches it; a host in a text for the reader is `origin`
        let allowed = ["http://www.w3.org/2000/svg"];
        for (name, bytes) in OWN {
            let text = std::str::from_utf8(bytes).unwrap();
            let text = allowed.iter().fold(text.to_owned(), |text, allowed| text.replace(allowed, ""));
            for mark in ["http://", "https://", "ws://", "wss://", "=\"//", "('//", "(//", "@import"] {
                assert!(!text.contains(mark), "{name} has {mark}");
            }
        }
    }

    #[test]
    fn our_pages_have_no_inline_script_or_style() {
        for (name, bytes) in OWN.iter().filter(|(name, _)| name.ends_with(".html")) {
            let text = std::str::from_utf8(bytes).unwrap();
            assert!(!text.contains("<style") && !text.contains("style="), "{name} has an inline style");
            for script in text.split("<script").skip(1) {
                let (attributes, rest) = script.split_once('>').unwrap();
                assert!(attributes.contains("src="), "{name} has an inline script");
                assert!(rest.starts_with("</script>"), "{name} has an inline script");
            }
            assert!(!text.contains(" onclick") && !text.contains(" onload"), "{name} has an inline handler");
            assert!(text.contains("<html lang=\"en\""), "{name} has no language");
        }
    }

    #[test]
    fn no_script_writes_markup() {
        for (name, bytes) in OWN.iter().filter(|(name, _)| name.ends_with(".js")) {
            let text = std::str::from_utf8(bytes).unwrap();
            for mark in
                ["innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function", "DOMParser"]
            {
                assert!(!text.contains(mark), "{name} uses {mark}");
            }
        }
    }
}
