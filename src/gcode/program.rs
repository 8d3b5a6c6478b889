/// A program's text: ASCII, one block a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    text: String,
    /// Where each step begins, and where the last ends; nothing of a text of unknown origin.
    bounds: Vec<usize>,
}

impl Program {
    /// Takes any text; only the check says whether it is a program.
    pub fn from_text(text: String) -> Program {
        Program { text, bounds: Vec::new() }
    }

    /// A text whose steps begin at `starts`, the last of them ending at `end`.
    pub(super) fn of_steps(text: String, starts: Vec<usize>, end: usize) -> Program {
        let bounds = if starts.is_empty() { starts } else { [starts, vec![end]].concat() };
        Program { text, bounds }
    }

    /// Each step as a program of its own: what stands before the first, the step, what stands
    /// after the last. Every step begins and ends parked, so it may be run by itself.
    pub fn steps(&self) -> Vec<String> {
        let (Some(first), Some(last)) = (self.bounds.first(), self.bounds.last()) else {
            return Vec::new();
        };
        let (head, tail) = (&self.text[..*first], &self.text[*last..]);
        let step = |w: &[usize]| [head, &self.text[w[0]..w[1]], tail].concat();
        self.bounds.windows(2).map(step).collect()
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
