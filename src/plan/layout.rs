//! How JSON is laid out in a plan file: indented as far as a person reads, one line below that.

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};
use std::io::{self, Write};

/// Containers nested deeper than this are written on one line: `steps[] · step · field`.
const OPEN_LEVELS: usize = 3;

/// The JSON of `value` with a newline at its end.
pub(super) fn to_json(value: &impl Serialize) -> Vec<u8> {
    let mut out = Vec::new();
    let mut serializer = Serializer::with_formatter(&mut out, Layout::default());
    // A Vec takes every byte and the plan types have string keys and finite-or-null numbers.
    value.serialize(&mut serializer).expect("plan types always serialise into memory");
    out.push(b'\n');
    out
}

#[derive(Default)]
struct Layout<'a> {
    depth: usize,
    pretty: PrettyFormatter<'a>,
}

impl Layout<'_> {
    fn open(&self) -> bool {
        self.depth <= OPEN_LEVELS
    }
}

/// Forwards one event to the indenting formatter, or writes the compact form.
macro_rules! choose {
    ($self:ident, $out:ident, $method:ident($($arg:expr),*), $compact:expr) => {
        if $self.open() { $self.pretty.$method($out, $($arg),*) } else { $compact }
    };
}

impl Formatter for Layout<'_> {
    fn begin_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.depth += 1;
        choose!(self, out, begin_array(), out.write_all(b"["))
    }

    fn end_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        let result = choose!(self, out, end_array(), out.write_all(b"]"));
        self.depth -= 1;
        result
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, out: &mut W, first: bool) -> io::Result<()> {
        choose!(self, out, begin_array_value(first), comma(out, first))
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        choose!(self, out, end_array_value(), Ok(()))
    }

    fn begin_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.depth += 1;
        choose!(self, out, begin_object(), out.write_all(b"{"))
    }

    fn end_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        let result = choose!(self, out, end_object(), out.write_all(b"}"));
        self.depth -= 1;
        result
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, out: &mut W, first: bool) -> io::Result<()> {
        choose!(self, out, begin_object_key(first), comma(out, first))
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        choose!(self, out, begin_object_value(), out.write_all(b":"))
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        choose!(self, out, end_object_value(), Ok(()))
    }
}

fn comma<W: ?Sized + Write>(out: &mut W, first: bool) -> io::Result<()> {
    if first { Ok(()) } else { out.write_all(b",") }
}

#[cfg(test)]
mod tests {
    use super::to_json;
    use serde_json::json;

    #[test]
    fn deep_containers_stay_on_one_line_and_the_value_survives() {
        let value = json!({"a": [{"deep": [[1, 2], [3]], "flat": 1}], "b": [], "c": {}});
        let text = String::from_utf8(to_json(&value)).unwrap();
        assert!(text.contains("\"deep\": [[1,2],[3]]"), "{text}");
        assert!(text.lines().count() > 5, "{text}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), value);
    }
}
