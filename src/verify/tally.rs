use super::{Rule, RuleResult};
use crate::voxel::Frame;

/// Offending voxels of one rule and step, merged in voxel order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tally {
    pub count: usize,
    /// In x, y, z order.
    pub first: Option<[usize; 3]>,
}

impl Tally {
    pub fn add(&mut self, voxel: [usize; 3]) {
        self.count += 1;
        self.first.get_or_insert(voxel);
    }

    /// Joins tallies given in voxel order.
    pub fn joined(tallies: impl IntoIterator<Item = Tally>) -> Tally {
        tallies.into_iter().fold(Tally::default(), |sum, t| Tally {
            count: sum.count + t.count,
            first: sum.first.or(t.first),
        })
    }

    /// The result of a rule that holds when nothing was tallied.
    pub fn result(
        self,
        rule: Rule,
        step: usize,
        figure_means: &'static str,
        frame: &Frame,
        why: impl FnOnce() -> String,
    ) -> RuleResult {
        let detail = match self.first {
            None => String::new(),
            Some(v) => format!("{}, first {}", why(), place(v, frame)),
        };
        RuleResult {
            rule,
            step: Some(step),
            passed: self.count == 0,
            figure: self.count as f64,
            figure_means,
            detail,
        }
    }
}

/// A voxel and its centre in the world, for people.
pub(super) fn place(v: [usize; 3], frame: &Frame) -> String {
    let (p, [i, j, k]) = (frame.center(v), v);
    format!("at ({:.2}, {:.2}, {:.2}) mm, voxel ({i}, {j}, {k})", p.x, p.y, p.z)
}
