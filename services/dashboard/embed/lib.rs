//! The files of the dashboard page, as bytes of this program.
//!
//! The page is TypeScript in this folder; `npm run build` writes it to `dist/`. With the feature `page`, that
//! folder is embedded. A debug build reads it while it runs, so the page can be built again without Rust.
//! Without the feature, there is one file, which says how to get the real page. So Rust builds need no
//! Node.js.

use std::borrow::Cow;

/// Whether this program has the page.
pub const IS_EMBEDDED: bool = cfg!(feature = "page");

/// Path of the page itself.
const INDEX: &str = "index.html";

/// Files below this path have a hash of their content in their names.
const HASHED: &str = "assets/";

/// A file of the page.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct File {
    /// Its bytes.
    pub content: Cow<'static, [u8]>,
    /// Its media type, with the character set of text.
    pub media_type: &'static str,
    /// An entity tag of the content, with quotes. It is weak, because answers may be compressed.
    pub etag: String,
    /// Whether the content never changes under this name.
    pub is_immutable: bool,
}

/// The file at an absolute path of the service, such as `/` or `/assets/index-Bq3.js`. `None` if there is
/// none.
pub fn file(path: &str) -> Option<File> {
    let path = path.strip_prefix('/')?;
    let path = if path.is_empty() { INDEX } else { path };
    let content = content(path)?;
    let hash = blake3::hash(&content).to_hex();
    Some(File {
        media_type: media_type(path),
        etag: format!("W/\"{}\"", &hash[..32]),
        is_immutable: IS_EMBEDDED && path.starts_with(HASHED),
        content,
    })
}

#[cfg(feature = "page")]
fn content(path: &str) -> Option<Cow<'static, [u8]>> {
    #[derive(rust_embed::RustEmbed)]
    #[folder = "dist"]
    struct Built;
    Built::get(path).map(|file| file.data)
}

#[cfg(not(feature = "page"))]
fn content(path: &str) -> Option<Cow<'static, [u8]>> {
    (path == INDEX).then_some(Cow::Borrowed(include_bytes!("absent.html")))
}

/// Media type by the end of a name. Vite writes no other kinds.
fn media_type(path: &str) -> &'static str {
    match path.rsplit_once('.').map(|(_, end)| end) {
        Some("html") => "text/html; charset=utf-8",
        Some("js" | "mjs") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("json" | "map") => "application/json",
        Some("webmanifest") => "application/manifest+json",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("ico") => "image/x-icon",
        Some("webp") => "image/webp",
        Some("woff2") => "font/woff2",
        Some("txt") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_at_the_root_and_nothing_outside_of_it_is_served() {
        let page = file("/").unwrap();
        assert_eq!(page, file("/index.html").unwrap());
        assert_eq!(page.media_type, "text/html; charset=utf-8");
        assert!(!page.is_immutable && page.content.starts_with(b"<!doctype html>"));
        for path in
            ["", "index.html", "/../Cargo.toml", "/..", "/assets", "/assets/", "/Cargo.toml", "//etc/passwd"]
        {
            assert_eq!(file(path), None, "{path}");
        }
    }

    #[cfg(not(feature = "page"))]
    #[test]
    fn the_page_in_place_of_the_real_one_says_how_to_get_that_and_runs_nothing() {
        let text = String::from_utf8(file("/").unwrap().content.into_owned()).unwrap();
        assert!(text.contains("--features dashboard"), "{text}");
        assert!(!text.contains("<script") && !text.contains("style"), "{text}");
    }
}
