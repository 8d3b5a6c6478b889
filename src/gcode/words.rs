//! Reads blocks of G-code into words. Shares nothing with the writer.

use std::borrow::Cow;

/// One word of a block: a letter and its number, kept also in thousandths to compare codes exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Word {
    pub letter: char,
    pub value: f64,
}

/// Longest block a control takes, bytes without the line end.
pub const LONGEST: usize = 256;

/// Larger numbers mean a corrupted file: no axis, speed or feed reaches a million.
const ABSURD: f64 = 1e6;

/// Digits a number may have; more are no position but noise.
const MOST_DIGITS: usize = 12;

/// What is wrong with a block.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadBlock {
    #[error("{0} bytes, more than {LONGEST}")]
    TooLong(usize),
    #[error("byte 0x{0:02X} is not printable ASCII")]
    NotAscii(u8),
    #[error("a comment is not closed or opens another")]
    Comment,
    #[error("'{0}' is no word: a letter and a number are expected")]
    NotAWord(String),
    #[error("'{0}' is no number of at most {MOST_DIGITS} digits within ±{ABSURD:.0}")]
    Number(String),
    #[error("letter {0} stands twice in one block")]
    Twice(char),
}

/// The words of one line; comments in parentheses and after a semicolon are dropped.
pub fn read(line: &str) -> Result<Vec<Word>, BadBlock> {
    if line.len() > LONGEST {
        return Err(BadBlock::TooLong(line.len()));
    }
    if let Some(b) = line.bytes().find(|b| !(0x20..0x7F).contains(b) && *b != b'\t') {
        return Err(BadBlock::NotAscii(b));
    }
    let code = without_comments(line)?;
    let mut words: Vec<Word> = Vec::new();
    let mut rest = code.trim_start();
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_alphabetic() {
            return Err(BadBlock::NotAWord(rest.chars().take(12).collect()));
        }
        let tail = rest[1..].trim_start();
        let end = tail
            .find(|c: char| c.is_ascii_alphabetic() || c.is_ascii_whitespace())
            .unwrap_or(tail.len());
        let value = parse_number(&tail[..end])?;
        let letter = letter.to_ascii_uppercase();
        // Several G and M codes of different groups may share a block.
        if !matches!(letter, 'G' | 'M') && words.iter().any(|w| w.letter == letter) {
            return Err(BadBlock::Twice(letter));
        }
        words.push(Word { letter, value });
        rest = tail[end..].trim_start();
    }
    Ok(words)
}

fn without_comments(line: &str) -> Result<Cow<'_, str>, BadBlock> {
    if !line.contains([';', '(', ')']) {
        return Ok(line.into());
    }
    let (mut out, mut open) = (String::with_capacity(line.len()), false);
    for c in line.chars() {
        match (c, open) {
            (';', false) => return Ok(out.into()),
            ('(', false) => open = true,
            ('(', true) | (')', false) => return Err(BadBlock::Comment),
            (')', true) => open = false,
            (_, true) => {}
            (c, false) => out.push(c),
        }
    }
    if open { Err(BadBlock::Comment) } else { Ok(out.into()) }
}

/// Sign, digits, at most one point; no exponent, no inf, no nan.
fn parse_number(text: &str) -> Result<f64, BadBlock> {
    let bad = || BadBlock::Number(text.chars().take(24).collect());
    let body = text.strip_prefix(['+', '-']).unwrap_or(text);
    let digits = body.bytes().filter(u8::is_ascii_digit).count();
    let points = body.bytes().filter(|b| *b == b'.').count();
    let whole = digits + points == body.len();
    if !whole || points > 1 || digits == 0 || digits > MOST_DIGITS {
        return Err(bad());
    }
    let value: f64 = text.parse().map_err(|_| bad())?;
    if value.abs() < ABSURD { Ok(value) } else { Err(bad()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn w(letter: char, value: f64) -> Word {
        Word { letter, value }
    }

    #[test]
    fn words_with_and_without_spaces_and_comments() {
        assert_eq!(
            read("G1X-1.5 y2 (turn) F100 ; end").unwrap(),
            [w('G', 1.0), w('X', -1.5), w('Y', 2.0), w('F', 100.0)]
        );
        assert_eq!(read("(only (talk)").unwrap_err(), BadBlock::Comment);
        assert_eq!(read("  ").unwrap(), []);
    }

    #[test]
    fn what_is_no_block_is_refused() {
        assert_eq!(read("X1e5").unwrap(), [w('X', 1.0), w('E', 5.0)], "no exponents");
        for bad in ["X", "X--1", "Xnan", "X1.2.3", "G1 X99999999", "X1 X2", "%", "#1=3", "[1]"] {
            assert!(read(bad).is_err(), "{bad}");
        }
        assert_eq!(read("G1 X\u{b5}").unwrap_err(), BadBlock::NotAscii(0xC2));
        assert_eq!(read(&"(".repeat(300)).unwrap_err(), BadBlock::TooLong(300));
    }

    proptest! {
        #[test]
        fn nothing_panics(line in "\\PC{0,60}") {
            let _ = read(&line);
        }

        #[test]
        fn numbers_come_back(v in -9999.0f64..9999.0) {
            let got = read(&format!("X{v:.3}")).unwrap();
            prop_assert!((got[0].value - v).abs() <= 0.0005 + 1e-9);
        }
    }
}
