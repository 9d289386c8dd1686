//! The text of OBJ and MTL files: encoding, continued lines and comments; and text on its way from one thread
//! to another.

use crate::error::SceneError;
use std::borrow::Cow;
use std::io::{self, BufRead, Read};
use std::sync::mpsc::{Receiver, Sender, channel};

/// The text of a file, with continued lines joined. Text that is not UTF-8 is Latin-1. A file with a NUL byte
/// is neither: the error has the line.
pub(crate) fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<Cow<'a, str>, SceneError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let mut text = match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(e) if bytes.contains(&0) => {
            let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
            return Err(SceneError::line(file, line, "is not UTF-8 text; save the file as UTF-8"));
        }
        Err(_) => Cow::Owned(bytes.iter().copied().map(char::from).collect()),
    };
    // Lines of old Macs end in `\r` alone.
    if text.contains('\r') && !text.contains('\n') {
        text = Cow::Owned(text.replace('\r', "\n"));
    }
    let goes_on = text.contains("\\\n") || text.contains("\\\r\n");
    Ok(if goes_on { Cow::Owned(joined(&text)) } else { text })
}

/// Joins each line that ends in `\` with the next one. Empty lines keep the numbers of later lines.
fn joined(text: &str) -> String {
    let mut joined = String::with_capacity(text.len());
    let (mut owed, mut is_comment) = (0, false);
    for line in text.lines() {
        if owed == 0 {
            is_comment = line.trim_start().starts_with('#');
        }
        match line.strip_suffix('\\').filter(|_| !is_comment) {
            Some(part) => {
                joined += part;
                joined.push(' ');
                owed += 1;
            }
            None => {
                joined += line;
                joined.extend(std::iter::repeat_n('\n', owed + 1));
                owed = 0;
            }
        }
    }
    joined
}

/// Removes a comment after numbers.
pub(crate) fn without_comment(numbers: &str) -> &str {
    numbers.split_once('#').map_or(numbers, |(numbers, _)| numbers.trim_end())
}

/// The file names in the rest of a `mtllib` line: all of it if that is a file, else its words. There may be
/// quotes around names, and a comment behind them.
pub(crate) fn file_names(rest: &str, is_file: impl Fn(&str) -> bool) -> Vec<&str> {
    if is_file(rest) {
        return vec![rest];
    }
    let comment = rest.match_indices('#').find(|(at, _)| rest[..*at].ends_with(char::is_whitespace));
    let names = comment.map_or(rest, |(at, _)| rest[..at].trim_end());
    if is_file(names) {
        return vec![names];
    }
    let mut words = Vec::new();
    for (i, part) in names.split('"').enumerate() {
        if i % 2 == 1 { words.push(part) } else { words.extend(part.split_whitespace()) }
    }
    // The name of a file that is missing may have spaces.
    let several = names.contains('"') || words.first().is_some_and(|word| is_file(word));
    if several { words } else { vec![names] }
}

/// Bytes that are sent together.
const PIECE: usize = 1 << 18;

/// Lines that another thread reads while they are written.
pub(crate) struct PipedText {
    piece: Vec<u8>,
    sender: Sender<Vec<u8>>,
}

/// A pipe for text. Whatever is written fits, so both ends may also be used one after the other.
pub(crate) fn piped_text() -> (PipedText, impl BufRead) {
    let (sender, receiver) = channel();
    (PipedText { piece: Vec::new(), sender }, Pieces { piece: Vec::new(), read: 0, receiver })
}

impl PipedText {
    /// Writes a line that consists of these parts.
    pub(crate) fn line(&mut self, parts: &[&str]) {
        for part in parts {
            self.piece.extend_from_slice(part.as_bytes());
        }
        self.piece.push(b'\n');
        if self.piece.len() >= PIECE {
            self.send();
        }
    }

    fn send(&mut self) {
        let next = Vec::with_capacity(PIECE + 1024);
        // A reader that has met an error reads no further.
        let _ = self.sender.send(std::mem::replace(&mut self.piece, next));
    }
}

impl Drop for PipedText {
    fn drop(&mut self) {
        self.send();
    }
}

struct Pieces {
    piece: Vec<u8>,
    /// Number of bytes of the piece that were read.
    read: usize,
    receiver: Receiver<Vec<u8>>,
}

impl BufRead for Pieces {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        while self.read == self.piece.len() {
            let Ok(piece) = self.receiver.recv() else { return Ok(&[]) };
            (self.piece, self.read) = (piece, 0);
        }
        Ok(&self.piece[self.read..])
    }

    fn consume(&mut self, read: usize) {
        self.read += read;
    }
}

impl Read for Pieces {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.fill_buf()?.read(buffer)?;
        self.consume(read);
        Ok(read)
    }
}
