//! Tokens of a text file with their line numbers, and the numbers in them.
//!
//! Works on bytes, so that a comment in any encoding does no harm. A line ends at LF, CR LF or CR.

use super::error::{Defect, Fault, Place, shown};

/// A cursor over whitespace-separated tokens that knows its line.
pub(super) struct Tokens<'a> {
    bytes: &'a [u8],
    at: usize,
    line: usize,
    comment: Option<u8>,
}

impl<'a> Tokens<'a> {
    /// Reads `bytes` from the start; `comment` begins a comment that ends with its line.
    pub fn new(bytes: &'a [u8], comment: Option<u8>) -> Self {
        Tokens { bytes, at: 0, line: 1, comment }
    }

    /// As [`Tokens::new`], for a body whose first line is line `line` of the file.
    pub fn at_line(bytes: &'a [u8], line: usize) -> Self {
        Tokens { bytes, at: 0, line, comment: None }
    }

    pub fn place(&self) -> Place {
        Place::Line(self.line)
    }

    pub fn remaining(&self) -> u64 {
        (self.bytes.len() - self.at) as u64
    }

    /// Steps over a line end if one is here.
    fn line_end(&mut self) -> bool {
        match self.bytes.get(self.at) {
            Some(b'\r') if self.bytes.get(self.at + 1) == Some(&b'\n') => self.at += 2,
            Some(b'\r' | b'\n') => self.at += 1,
            _ => return false,
        }
        self.line += 1;
        true
    }

    fn skip_to_line_end(&mut self) {
        while !matches!(self.bytes.get(self.at), None | Some(b'\r' | b'\n')) {
            self.at += 1;
        }
    }

    /// The next token on this line; `None` at its end.
    pub fn on_line(&mut self) -> Option<&'a [u8]> {
        while matches!(self.bytes.get(self.at), Some(b' ' | b'\t' | 0x0b | 0x0c)) {
            self.at += 1;
        }
        let start = self.at;
        if self.comment.is_some() && self.bytes.get(start) == self.comment.as_ref() {
            self.skip_to_line_end();
            return None;
        }
        while self.bytes.get(self.at).is_some_and(|b| !b.is_ascii_whitespace() && *b != 0x0b) {
            self.at += 1;
        }
        (self.at > start).then(|| &self.bytes[start..self.at])
    }

    /// Leaves the rest of this line; `false` when the file ends with it.
    pub fn next_line(&mut self) -> bool {
        self.skip_to_line_end();
        self.line_end()
    }

    /// The next token, on this line or a later one; `None` at the end of the file.
    pub fn next(&mut self) -> Option<&'a [u8]> {
        loop {
            if let Some(token) = self.on_line() {
                return Some(token);
            }
            if !self.line_end() {
                return None;
            }
        }
    }

    /// The next token as a number, or the fault that there is none.
    pub fn number(&mut self, expecting: &'static str) -> Result<f64, Fault> {
        let token = self.next().ok_or((self.place(), Defect::Truncated { expecting }))?;
        number(token, expecting).map_err(|d| (self.place(), d))
    }

    /// The next token as a count or index, or the fault that there is none.
    pub fn integer(&mut self, expecting: &'static str) -> Result<i64, Fault> {
        let token = self.next().ok_or((self.place(), Defect::Truncated { expecting }))?;
        integer(token, expecting).map_err(|d| (self.place(), d))
    }
}

/// A token as a number; infinite and NaN are left for the vertex check to name.
pub(super) fn number(token: &[u8], expected: &'static str) -> Result<f64, Defect> {
    std::str::from_utf8(token)
        .ok()
        .and_then(|s| s.parse().ok())
        .ok_or_else(|| Defect::Unexpected { expected, found: shown(token) })
}

/// A token as a whole number.
pub(super) fn integer(token: &[u8], expected: &'static str) -> Result<i64, Defect> {
    std::str::from_utf8(token)
        .ok()
        .and_then(|s| s.parse().ok())
        .ok_or_else(|| Defect::Unexpected { expected, found: shown(token) })
}

/// Refuses a declared count whose items cannot fit in the bytes that follow, before anything is
/// allocated for them.
pub(super) fn check_count(
    what: &str,
    declared: u64,
    bytes_each: u64,
    available: u64,
    place: Place,
) -> Result<(), Fault> {
    let needed = declared.saturating_mul(bytes_each);
    if needed > available {
        let what = shown(what.as_bytes());
        return Err((place, Defect::CountTooLarge { what, declared, needed, available }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_counted_whatever_ends_them() {
        for text in ["a b\n# c\nd", "a b\r\n# c\r\nd", "a b\r# c\rd"] {
            let mut t = Tokens::new(text.as_bytes(), Some(b'#'));
            assert_eq!(t.next(), Some(&b"a"[..]));
            assert_eq!(t.on_line(), Some(&b"b"[..]));
            assert_eq!(t.on_line(), None);
            assert_eq!(t.next(), Some(&b"d"[..]));
            assert_eq!(t.place(), Place::Line(3));
            assert_eq!(t.next(), None);
        }
    }

    #[test]
    fn numbers_are_exact_and_junk_is_shown_short() {
        assert_eq!(number(b"-1.5e-3", "a number").unwrap(), -0.0015);
        let junk = number(&[0xff; 100], "a number").unwrap_err().to_string();
        assert!(junk.contains('…') && junk.chars().count() < 150, "{junk}");
        assert!(integer(b"3.0", "an index").is_err());
    }
}
