//! The bearer token of a client.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::RwLock;

/// A bearer token. Its debug form hides it, so logs do not show it. Clones share it.
///
/// A token from a file is read again when the service refuses it: whoever rotates the token writes the new
/// one into the file, and the client goes on.
#[derive(Clone)]
pub struct Token(Arc<Source>);

struct Source {
    secret: RwLock<String>,
    file: Option<PathBuf>,
}

impl Token {
    /// The token in this text, without surrounding white space such as a file's last newline.
    pub fn new(text: &str) -> Self {
        Self::from(text.trim().to_owned(), None)
    }

    /// The token in this file. `None` if the file holds none.
    pub fn in_file(path: &Path) -> std::io::Result<Option<Self>> {
        Ok(read(path)?.map(|secret| Self::from(secret, Some(path.to_owned()))))
    }

    fn from(secret: String, file: Option<PathBuf>) -> Self {
        Self(Arc::new(Source { secret: RwLock::new(secret), file }))
    }

    pub(crate) fn secret(&self) -> String {
        self.0.secret.read().clone()
    }

    /// Reads the file again. Whether there is a token now that differs from the one that was `sent`, maybe
    /// because another request has read it already.
    pub(crate) fn read_again(&self, sent: Option<&str>) -> bool {
        if let Some(path) = &self.0.file
            && let Ok(Some(secret)) = read(path)
        {
            *self.0.secret.write() = secret;
        }
        sent != Some(self.secret().as_str())
    }
}

/// A token is one word.
fn read(path: &Path) -> std::io::Result<Option<String>> {
    let text = std::fs::read_to_string(path)?;
    let text = text.trim();
    Ok(Some(text.to_owned()).filter(|text| !text.is_empty() && !text.contains(char::is_whitespace)))
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_in_a_file_is_read_again_after_it_was_rotated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rack-7.token");
        std::fs::write(&path, "old\n").unwrap();
        let token = Token::in_file(&path).unwrap().unwrap();
        let clone = token.clone();
        assert!(!token.read_again(Some("old")), "nothing has changed");
        std::fs::write(&path, "new").unwrap();
        assert!(token.read_again(Some("old")));
        assert_eq!(clone.secret(), "new");
        // A file that is just being written, or that is gone, changes nothing.
        std::fs::write(&path, "").unwrap();
        assert!(!token.read_again(Some("new")));
        std::fs::remove_file(&path).unwrap();
        assert!(!token.read_again(Some("new")));
        assert!(Token::in_file(&path).is_err());
        assert!(!Token::new("a").read_again(Some("a")));
    }
}
