//! Output as lines of bounded length.

use std::io::Read;
use std::sync::mpsc::SyncSender;

/// Longest line, bytes. What is longer comes in several lines.
pub const LONGEST_LINE: usize = 8192;

/// Lines that wait to be taken. Beyond that, the program has to wait.
pub(super) const WAITING_LINES: usize = 256;

/// Where a line was printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// Standard output.
    Out,
    /// Standard error.
    Error,
}

/// A line of output, without its end. Bytes that are no UTF-8 are replaced.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Where it was printed.
    pub stream: Stream,
    /// Its text.
    pub text: String,
}

/// Reads lines until the end of the stream. A carriage return ends a line too: progress bars use it. Without
/// a receiver, the rest is read and dropped, so that the program does not wait for ever.
pub(super) fn read_lines(mut from: impl Read, stream: Stream, to: &SyncSender<Line>) {
    let mut buffer = vec![0; 64 * 1024];
    let mut line = Vec::new();
    let send = |line: &mut Vec<u8>| {
        if !line.is_empty() {
            let text = String::from_utf8_lossy(line).into_owned();
            line.clear();
            // Fails without a receiver, and is not needed then.
            let _ = to.send(Line { stream, text });
        }
    };
    loop {
        let read = match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(_) => break,
        };
        let mut rest = &buffer[..read];
        while !rest.is_empty() {
            let end = rest.iter().position(|&b| b == b'\n' || b == b'\r');
            let room = LONGEST_LINE - line.len();
            let taken = end.unwrap_or(rest.len()).min(room);
            line.extend_from_slice(&rest[..taken]);
            let ended = end == Some(taken);
            rest = &rest[taken + usize::from(ended)..];
            if ended || line.len() == LONGEST_LINE {
                send(&mut line);
            }
        }
    }
    send(&mut line);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    fn lines(bytes: &[u8]) -> Vec<String> {
        let (to, from) = sync_channel(1000);
        read_lines(bytes, Stream::Out, &to);
        drop(to);
        from.iter().map(|line| line.text).collect()
    }

    #[test]
    fn newlines_and_carriage_returns_end_lines_and_the_last_needs_none() {
        assert_eq!(lines(b"one\r\ntwo\rthree\n\nfour"), ["one", "two", "three", "four"]);
        assert_eq!(lines(b"\xff!"), ["\u{fffd}!"]);
    }

    #[test]
    fn long_lines_come_in_pieces() {
        let found = lines(&vec![b'x'; 2 * LONGEST_LINE + 5]);
        assert_eq!(found.iter().map(String::len).collect::<Vec<_>>(), [LONGEST_LINE, LONGEST_LINE, 5]);
    }
}
