//! The tree of a run as text: one line a state in the order in which states were seen, tab
//! separated, with a line of headings. Costs are voxels added with the usual nozzle.

use super::site::AXES;
use super::world::Action;
use crate::plan::{Job, StepKind};
use crate::search::Found;
use std::fmt::Write as _;

pub fn text(job: &Job, found: &Found<Action>) -> String {
    let mut out = String::from(
        "state\tfrom\taction\ttool\tdirection\tpaid\tremaining\toff\tgoal\texpanded\n",
    );
    for (n, s) in found.tree.iter().enumerate() {
        let (from, action, tool, direction) = match &s.from {
            None => ("-".into(), "-".into(), "-".into(), "-".into()),
            Some((from, a)) => {
                let tools = match a.kind() {
                    StepKind::Subtractive => &job.cutters,
                    StepKind::Additive => &job.nozzles,
                };
                let tool = tools.get(a.tool).map_or("-", |t| &t.name);
                let d = AXES[a.axis].vec();
                let direction = format!("{},{},{}", d.x, d.y, d.z);
                (from.to_string(), format!("{:?}", a.action), tool.to_string(), direction)
            }
        };
        let expanded = s.expanded.map_or("-".into(), |e| e.to_string());
        // Writing into a String cannot fail.
        let _ = writeln!(
            out,
            "{n}\t{from}\t{action}\t{tool}\t{direction}\t{:.1}\t{:.1}\t{}\t{}\t{expanded}",
            s.paid, s.remaining, s.shortfall, s.goal
        );
    }
    out
}
