use super::Measures;
use crate::plan::Plan;
use std::fmt;

/// The rules of `docs/RULES.md`, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    Content,
    ToolAccess,
    Support,
    Stability,
    Machine,
    End,
}

impl Rule {
    pub const ALL: [Rule; 6] =
        [Rule::Content, Rule::ToolAccess, Rule::Support, Rule::Stability, Rule::Machine, Rule::End];

    /// The rule's name as the rules page, the plan file and the terminal spell it.
    pub fn name(self) -> &'static str {
        match self {
            Rule::Content => "content",
            Rule::ToolAccess => "tool-access",
            Rule::Support => "support",
            Rule::Stability => "stability",
            Rule::Machine => "machine",
            Rule::End => "end",
        }
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One rule held against one step, or against the whole plan (`step` is None).
#[derive(Clone, Debug, PartialEq)]
pub struct RuleResult {
    pub rule: Rule,
    /// Index into [`Plan::steps`].
    pub step: Option<usize>,
    pub passed: bool,
    /// How far the rule is from holding; what it counts or measures is in `figure_means`.
    pub figure: f64,
    /// What the figure is, such as "voxels not reachable".
    pub figure_means: &'static str,
    /// What is wrong, where (first offender, world position) and how to mend it; empty when the
    /// rule holds.
    pub detail: String,
}

/// What the verifier found, with the plan it judged.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// One result a rule and step, in order of the steps; the end last.
    pub rules: Vec<RuleResult>,
    pub plan: Plan,
    pub measures: Measures,
}

impl Verdict {
    pub fn passed(&self) -> bool {
        self.rules.iter().all(|r| r.passed)
    }

    /// Names of the rules that fail somewhere, each once, in the order of the rules page.
    pub fn failed_rules(&self) -> Vec<&'static str> {
        let fails = |rule: &Rule| self.rules.iter().any(|r| r.rule == *rule && !r.passed);
        Rule::ALL.into_iter().filter(fails).map(Rule::name).collect()
    }

    /// The plan as one that may be made, or the verdict back when a rule fails.
    pub fn into_verified(self) -> Result<Verified<Plan>, Box<Verdict>> {
        if self.passed() { Ok(Verified(self.plan)) } else { Err(Box::new(self)) }
    }

    /// One line a rule: its name, whether it holds, its figure, and where it fails first.
    pub fn lines(&self) -> Vec<String> {
        Rule::ALL.into_iter().map(|rule| self.line(rule)).collect()
    }

    fn line(&self, rule: Rule) -> String {
        let results: Vec<&RuleResult> = self.rules.iter().filter(|r| r.rule == rule).collect();
        let Some(failure) = results.iter().find(|r| !r.passed) else {
            return match results.last() {
                None => format!("{rule:<12} ok      nothing to judge"),
                Some(r) if rule == Rule::End => {
                    format!("{rule:<12} ok      {} {}", number(r.figure), r.figure_means)
                }
                Some(_) => format!("{rule:<12} ok      in {} steps", results.len()),
            };
        };
        let failures = results.iter().filter(|r| !r.passed).count();
        let place = failure.step.map_or(String::new(), |s| format!("steps[{s}]: "));
        let more = match failures {
            1 => String::new(),
            n => format!("; and in {} more steps", n - 1),
        };
        let (figure, means) = (number(failure.figure), failure.figure_means);
        format!("{rule:<12} FAILED  {place}{figure} {means}; {}{more}", failure.detail)
    }
}

fn number(figure: f64) -> String {
    if figure.fract() == 0.0 { format!("{figure:.0}") } else { format!("{figure:.6}") }
}

/// A value the verifier has found to obey every rule. Only the verifier makes one.
///
/// ```compile_fail
/// let forged = hmplan::verify::Verified(1);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Verified<T>(T);

impl<T> Verified<T> {
    pub fn get(&self) -> &T {
        &self.0
    }

    /// The value, no longer known to be verified: whoever changes it must verify again.
    pub fn into_inner(self) -> T {
        self.0
    }
}
