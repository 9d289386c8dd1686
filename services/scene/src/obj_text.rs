//! The text of OBJ and MTL files: encoding, continued lines and comments; and text on its way from one thread
//! to another.

use crate::error::SceneError;
use std::borrow::Cow;
use std::io::{self, BufRead, Read};
use std::sync::mpsc::{Receiver, Sender, channel};

/// The text of a file, with continued lines joined. If it is not UTF-8, the error has the line.
pub(crate) fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<Cow<'a, str>, SceneError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let text = std::str::from_utf8(bytes).map_err(|e| {
        let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
        SceneError::line(file, line, "is not UTF-8 text")
    })?;
    let goes_on = text.contains("\\\n") || text.contains("\\\r\n");
    Ok(if goes_on { Cow::Owned(joined(text)) } else { Cow::Borrowed(text) })
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
