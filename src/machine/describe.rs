//! What a person reads about a tool or a machine.

use super::joints::Linear;
use super::kinematics::{Chain, Mount, Rotary};
use super::process;
use super::{Machine, Shape, Table, Tool, ToolKind};
use std::fmt::Write;

/// A tool in several lines: figures, then sections from the tip upward, then its process.
pub fn describe_tool(tool: &Tool) -> String {
    let kind = match tool.kind {
        ToolKind::Subtractive => "cutter",
        ToolKind::Additive => "nozzle",
    };
    let mut text = format!("{} ({kind})\n", tool.name);
    let mut line = |label: &str, value: String| push(&mut text, label, &value);
    line("gauge length", format!("{} mm (tip to spindle nose)", show(tool.gauge_mm())));
    if tool.kind == ToolKind::Subtractive {
        line(
            "edge",
            format!(
                "Ø {} mm, {} mm long",
                show(2.0 * tool.active_radius()),
                show(tool.active_length())
            ),
        );
    }
    let reach = tool.reach(tool.tip_radius());
    if reach.is_finite() {
        line("reach", format!("{} mm before it widens beyond its tip", show(reach)));
    }
    for (i, section) in tool.sections.iter().enumerate() {
        let active = if section.active { ", active" } else { "" };
        let label = if i == 0 { "sections" } else { "" };
        line(label, format!("{}{active}", describe_shape(&section.shape)));
    }
    line("process", process::describe(tool.kind, &tool.process));
    if Tool::is_voxel_sized(&tool.name) {
        line(
            "note",
            "one voxel wide: figures here are for a pitch of 1 mm and follow the plan's \
             pitch"
                .into(),
        );
    }
    text
}

fn describe_shape(shape: &Shape) -> String {
    match *shape {
        Shape::Ball { radius } => format!("ball end, radius {} mm", show(radius)),
        Shape::BullNose { radius, corner } => {
            format!("flat end, radius {} mm, corner {} mm", show(radius), show(corner))
        }
        Shape::Frustum { z0, r0, z1, r1 } if r0 == r1 => {
            format!("{} to {} mm: radius {} mm", show(z0), show(z1), show(r0))
        }
        Shape::Frustum { z0, r0, z1, r1 } => {
            format!("{} to {} mm: radius {} to {} mm", show(z0), show(z1), show(r0), show(r1))
        }
        Shape::Platform { z } => format!("platform without end above {} mm", show(z)),
    }
}

/// A machine in several lines: holding, axes, control, extruder, tools.
pub fn describe(machine: &Machine) -> String {
    let mut text = match machine.description.as_str() {
        "" => format!("{}\n", machine.name),
        about => format!("{}: {about}\n", machine.name),
    };
    let mut line = |label: &str, value: String| push(&mut text, label, &value);
    line("arrangement", arrangement(&machine.kinematics));
    let table = match machine.workholding.table {
        Table::Disc { radius_mm } => format!("disc of radius {} mm", show(radius_mm)),
        Table::Box { x_mm, y_mm } => format!("{} × {} mm", show(x_mm), show(y_mm)),
    };
    line("table", format!("{table}, pedestal {} mm", show(machine.workholding.pedestal_mm)));
    let chain = &machine.kinematics;
    for (letter, axis) in [("axis X", chain.x), ("axis Y", chain.y), ("axis Z", chain.z)] {
        line(letter, describe_linear(&axis));
    }
    for axis in chain.rotary_axes() {
        line(&format!("axis {}", axis.letter), describe_rotary(axis));
    }
    let control = &machine.control;
    line(
        "control",
        format!(
            "dialect {}, retract {} mm over the highest obstacle, rapid {} mm/min, feed up to {} \
         mm/min, spindle up to {} rpm",
            control.dialect,
            control.clearance_mm,
            control.rapid_mm_min,
            control.max_feed_mm_min,
            control.max_spindle_rpm
        ),
    );
    match &machine.extruder {
        Some(e) => {
            let codes = e.codes().map(|(key, code)| format!("{} {code}", &key[2..])).join(", ");
            line("extruder", format!("{} mm³/s; {codes}", e.volumetric_mm3_s));
        }
        None => line("extruder", "none".into()),
    }
    for (i, tool) in machine.tools.iter().enumerate() {
        let label = if i == 0 { "tools" } else { "" };
        line(label, summary(tool));
    }
    text
}

/// A tool on one line.
fn summary(tool: &Tool) -> String {
    let (kind, radius) = match tool.kind {
        ToolKind::Subtractive => ("cutter", tool.active_radius()),
        ToolKind::Additive => ("nozzle", tool.tip_radius()),
    };
    format!("{}: {kind} Ø {} mm, gauge {} mm", tool.name, show(2.0 * radius), show(tool.gauge_mm()))
}

fn arrangement(chain: &Chain) -> String {
    let body = |axis: &Rotary| match axis.on {
        Mount::Table => "table",
        Mount::Head => "head",
    };
    let joined = |of: &dyn Fn(&Rotary) -> String, by: &str| {
        chain.rotary_axes().map(of).collect::<Vec<_>>().join(by)
    };
    match chain.rotary_axes().count() {
        0 => "three linear axes".into(),
        _ => {
            format!("{} ({})", joined(&|r| body(r).into(), "/"), joined(&|r| r.letter.into(), " "))
        }
    }
}

fn describe_linear(axis: &Linear) -> String {
    let [low, high] = axis.limits_mm;
    let mut text =
        format!("{} to {} mm, parks at {} mm", show(low), show(high), show(axis.home_mm));
    if axis.on == Mount::Table {
        text += "; moves the table";
    }
    if let Some(d) = axis.axis {
        let vector = d.vec().to_array().map(show).join(", ");
        text += &format!("; along ({vector})");
    }
    if axis.carried_by > 0 {
        text += &format!("; carried by {} of its body's rotary axes", axis.carried_by);
    }
    text
}

fn describe_rotary(axis: &Rotary) -> String {
    let range = match axis.limits_deg {
        Some([low, high]) => format!("{} to {} degrees", show(low), show(high)),
        None => "turns without end".into(),
    };
    let (body, from) = match axis.on {
        Mount::Table => ("turns the table", "machine zero"),
        Mount::Head => ("turns the head", "the spindle nose"),
    };
    let vector = axis.axis.vec().to_array().map(show).join(", ");
    let pivot = axis.pivot_mm.map(show).join(", ");
    format!("{range}; {body} about ({vector}) through ({pivot}) mm from {from}")
}

/// A figure without needless digits; zero without a sign.
pub(super) fn show(value: f64) -> String {
    let text = format!("{value:.3}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".into() } else { short.into() }
}

fn push(text: &mut String, label: &str, value: &str) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "  {label:<13} {value}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_is_told_from_the_tip_upward() {
        let text = describe_tool(&Tool::builtin("w2v-cutter").unwrap());
        for part in [
            "w2v-cutter (cutter)",
            "43 mm (tip to spindle nose)",
            "Ø 3 mm, 13 mm long",
            "ball end, radius 1.5 mm, active",
            "13 to 43 mm: radius 25 mm\n",
            "platform without end above 43 mm",
            "0.2 mm of stock left",
        ] {
            assert!(text.contains(part), "{part:?} is missing in\n{text}");
        }
        let text = describe_tool(&Tool::builtin("inv-nozzle").unwrap());
        assert!(text.contains("one voxel wide"), "{text}");
    }

    #[test]
    fn a_machine_is_told_axis_by_axis() {
        let text = describe(&Machine::builtin("5xm600").unwrap());
        for part in [
            "head/table (B C)",
            "disc of radius 150 mm, pedestal 100 mm",
            "-300 to 300 mm, parks at 0 mm",
            "-100 to 100 degrees; turns the head about (0, 1, 0)",
            "turns without end; turns the table about (0, 0, -1)",
            "retract_on M74",
            "long-cutter: cutter Ø 6 mm, gauge 120 mm",
        ] {
            assert!(text.contains(part), "{part:?} is missing in\n{text}");
        }
    }
}
