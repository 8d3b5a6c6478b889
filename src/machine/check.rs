//! What is questionable about a machine profile whose figures are each in range.

use super::describe::show;
use super::kinematics::{Mount, Rotary};
use super::travel::corners;
use super::{Holding, Machine, Tool, ToolKind};
use crate::base::{Aabb, DVec3, Direction, fibonacci_sphere};

/// Directions on the sphere for the summary: neighbours 3° apart. Fewer would miss narrow gaps,
/// more would only make the check slower.
const DIRECTIONS: usize = 4000;

/// Cubes are measured to this, mm.
const CUBE_MM: f64 = 1.0;

/// Findings about a machine, one a line: those that begin with `warning:` want attention, those
/// that begin with `note:` say what the machine can do.
pub fn check(machine: &Machine) -> Vec<String> {
    let mut findings = Vec::new();
    warn_about_tools(machine, &mut findings);
    warn_about_axes(machine, &mut findings);
    note_reach(machine, &mut findings);
    findings
}

fn warn_about_tools(machine: &Machine, findings: &mut Vec<String>) {
    for (kind, word) in [(ToolKind::Subtractive, "cutter"), (ToolKind::Additive, "nozzle")] {
        if machine.tools_of(kind).is_empty() {
            findings.push(format!("warning: there is no {word} in the tool table"));
        }
    }
    let nozzles = !machine.tools_of(ToolKind::Additive).is_empty();
    if nozzles && machine.extruder.is_none() {
        findings.push("warning: there are nozzles but no [extruder]".into());
    }
    for tool in &machine.tools {
        if let Some(z) = narrows_at(tool) {
            findings.push(format!(
                "warning: tool '{}' is narrower above {} mm than below; collisions are judged as \
                 if it kept its width",
                tool.name,
                show(z)
            ));
        }
        if tool.max_radius() >= machine.workholding.pedestal_mm {
            findings.push(format!(
                "warning: tool '{}' has a radius of {} mm, the pedestal is {} mm high: held level \
                 at the part's foot it meets the table",
                tool.name,
                show(tool.max_radius()),
                show(machine.workholding.pedestal_mm)
            ));
        }
        let speed = tool.process.spindle_rpm;
        if tool.kind == ToolKind::Subtractive && speed > machine.control.max_spindle_rpm {
            findings.push(format!(
                "warning: tool '{}' wants {speed} rpm, the control allows {}",
                tool.name, machine.control.max_spindle_rpm
            ));
        }
        if let (ToolKind::Additive, Some(extruder)) = (tool.kind, &machine.extruder) {
            let feed = extruder.feed_mm_min(&tool.process);
            if feed > machine.control.max_feed_mm_min {
                findings.push(format!(
                    "warning: nozzle '{}' must move at {} mm/min to lay its bead at {} mm³/s, the \
                     control allows {}",
                    tool.name,
                    show(feed),
                    extruder.volumetric_mm3_s,
                    machine.control.max_feed_mm_min
                ));
            }
        }
    }
}

/// Height at which the tool's outline first shrinks upward, if it does below its top.
fn narrows_at(tool: &Tool) -> Option<f64> {
    // Between the ends of sections the outline is monotone, so it is enough to look just below and
    // just above each of them.
    const STEP_MM: f64 = 1e-6;
    let widest =
        |z: f64| tool.sections.iter().filter_map(|s| s.shape.radius_at(z)).fold(0.0, f64::max);
    let mut ends: Vec<f64> =
        tool.sections.iter().flat_map(|s| [s.shape.bottom(), s.shape.top()]).collect();
    ends.sort_by(f64::total_cmp);
    ends.dedup();
    let top = ends.pop()?;
    let mut probes: Vec<f64> =
        ends.iter().flat_map(|z| [z - STEP_MM, z + STEP_MM]).filter(|z| *z >= 0.0).collect();
    if top.is_finite() {
        probes.push(top - STEP_MM);
    }
    probes.windows(2).find(|w| widest(w[1]) < widest(w[0]) - 10.0 * STEP_MM).map(|w| w[0])
}

fn warn_about_axes(machine: &Machine, findings: &mut Vec<String>) {
    let chain = &machine.kinematics;
    let carried = if chain.second.on == Mount::Table { &chain.second } else { &chain.first };
    if carried.on == Mount::Table && !carried.is_absent() {
        let offset = DVec3::from_array(chain.table_center_mm) - DVec3::from_array(carried.pivot_mm);
        let away = carried.axis.vec().cross(offset).length();
        if away > 1e-6 {
            findings.push(format!(
                "warning: the table's centre is {} mm off axis {}",
                show(away),
                carried.letter
            ));
        }
    }
    for axis in chain.rotary_axes() {
        if !covers_half_turn(axis) {
            findings.push(format!("warning: axis {} turns by less than 180 degrees", axis.letter));
        }
    }
}

fn covers_half_turn(axis: &Rotary) -> bool {
    axis.limits_deg.is_none_or(|[low, high]| high - low >= 180.0)
}

fn note_reach(machine: &Machine, findings: &mut Vec<String>) {
    let reached = match machine.kinematics.rotary_axes().count() {
        2 => note_share(machine, findings),
        count => note_ways(machine, count, findings),
    };
    for tool in &machine.tools {
        let cube = largest_cube(machine, tool, &reached);
        let word = if cube < CUBE_MM { "warning" } else { "note" };
        findings.push(format!(
            "{word}: with '{}' a cube of {cube:.0} mm on the pedestal is within the travel from \
             all of them, clearance included",
            tool.name
        ));
    }
}

/// The directions along which a machine of three or four axes points, as long as they look down on the part.
fn note_ways(machine: &Machine, count: usize, findings: &mut Vec<String>) -> Vec<Direction> {
    let ways = machine.sampled(Direction::Z, DIRECTIONS);
    let upper: Vec<Direction> = ways.into_iter().filter(|d| d.vec().z >= 0.0).collect();
    let how = match (count, upper.len()) {
        (0, _) => "no rotary axis: the tool points one way",
        (_, 1) => "one rotary axis, about the tool: the tool points one way",
        _ => "one rotary axis: the tool points along one plane or cone",
    };
    findings.push(format!("note: {how}"));
    upper
}

/// How much of the sphere a machine with two rotary axes points along; the directions of the upper half.
fn note_share(machine: &Machine, findings: &mut Vec<String>) -> Vec<Direction> {
    let sphere = fibonacci_sphere(DIRECTIONS);
    let can = |d: &&Direction| machine.can_point(Direction::Z, **d);
    let upper: Vec<Direction> = sphere.iter().filter(|d| d.vec().z >= 0.0).copied().collect();
    let reached: Vec<Direction> = upper.iter().filter(can).copied().collect();
    let share = 100.0 * reached.len() as f64 / upper.len().max(1) as f64;
    let below = sphere.iter().filter(|d| d.vec().z < 0.0).filter(can).count();
    let lower = 100.0 * below as f64 / (DIRECTIONS - upper.len()).max(1) as f64;
    let word = if share < 50.0 { "warning" } else { "note" };
    findings.push(format!(
        "{word}: {share:.1} % of the directions above the horizontal can be pointed at, {lower:.1} \
         % of those below"
    ));
    reached
}

/// Edge of the largest cube on the pedestal whose corners, and the points one clearance above
/// them along the tool, are within travel from every direction; 0 when there is none.
fn largest_cube(machine: &Machine, tool: &Tool, directions: &[Direction]) -> f64 {
    let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
    let home = machine.kinematics.home();
    let fits = |edge: f64| {
        let half = edge / 2.0;
        let cube = Aabb { min: DVec3::new(-half, -half, 0.0), max: DVec3::new(half, half, edge) };
        directions.iter().all(|d| {
            let away = d.vec() * machine.control.clearance_mm;
            let mut tips = corners(cube).to_vec();
            tips.extend(corners(cube).map(|p| p + away));
            machine.posture(&placement, *d, home, tool, &tips).is_ok()
        })
    };
    let (mut low, mut high) = (0.0, 2048.0);
    while high - low > CUBE_MM {
        let middle = (low + high) / 2.0;
        if fits(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{Section, Shape};

    #[test]
    fn built_in_machines_want_no_attention() {
        for name in Machine::builtin_names() {
            let machine = Machine::builtin(name).unwrap();
            for finding in check(&machine) {
                assert!(finding.starts_with("note:"), "{name}: {finding}");
            }
        }
    }

    #[test]
    fn the_default_machine_takes_a_large_part_from_the_whole_upper_hemisphere() {
        let machine = Machine::builtin(Machine::DEFAULT).unwrap();
        let placement = machine.placement(&Holding::AS_CLAMPED, DVec3::ZERO);
        let part = Aabb { min: DVec3::new(-55.0, -90.0, 0.0), max: DVec3::new(55.0, 90.0, 65.0) };
        let horizontal = [Direction::X, Direction::NEG_X, Direction::Y, Direction::NEG_Y];
        let upper = fibonacci_sphere(1000).into_iter().filter(|d| d.vec().z >= 0.0);
        for d in upper.chain(horizontal) {
            for tool in &machine.tools {
                let away = d.vec() * machine.control.clearance_mm;
                let mut tips = corners(part).to_vec();
                tips.extend(corners(part).map(|p| p + away));
                let home = machine.kinematics.home();
                let found = machine.posture(&placement, d, home, tool, &tips);
                assert!(found.is_ok(), "{d:?} {}: {found:?}", tool.name);
            }
        }
    }

    #[test]
    fn a_narrowing_tool_a_missing_extruder_and_a_poor_tilt_are_found() {
        let mut machine = Machine::builtin("mx220").unwrap();
        machine.extruder = None;
        machine.kinematics.first.limits_deg = Some([-30.0, 30.0]);
        machine.kinematics.second.pivot_mm = [3.0, 4.0, 0.0];
        machine.tools[0].sections[3] = Section {
            shape: Shape::Frustum { z0: 35.0, r0: 7.0, z1: 55.0, r1: 7.0 },
            active: false,
        };
        let findings = check(&machine).join("\n");
        for part in [
            "nozzles but no [extruder]",
            "'ball-3x13' is narrower above 35 mm",
            "centre is 5 mm off axis C",
            "axis A turns by less than 180 degrees",
            // 1 − cos 30° of the hemisphere
            "warning: 13.4 % of the directions above",
        ] {
            assert!(findings.contains(part), "{part:?} is missing in\n{findings}");
        }
    }
}
