/// A program's text: ASCII, one block a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    text: String,
}

impl Program {
    /// Takes any text; only the check says whether it is a program.
    pub fn from_text(text: String) -> Program {
        Program { text }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    pub fn lines(&self) -> impl Iterator<Item = &str> {
        self.text.lines()
    }
}

/// What the check has passed. Only [`super::check_program`] makes one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checked<T>(T);

impl<T> Checked<T> {
    pub(super) fn new(inner: T) -> Self {
        Checked(inner)
    }

    pub fn get(&self) -> &T {
        &self.0
    }

    pub fn into_inner(self) -> T {
        self.0
    }
}
