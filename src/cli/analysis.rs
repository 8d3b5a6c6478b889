//! The outcome of `hmplan analyze`: a record for programs, a table for people, a coloured mesh.

use super::exit::Failure;
use super::inputs::Part;
use super::output::{ANALYSIS, COLOURS, Destination};
use super::paint::Paint;
use hmplan::access::{Damage, Survey};
use hmplan::base::{Ctx, Direction};
use hmplan::mesh::TriMesh;
use hmplan::voxel::{BitGrid, Frame};
use serde::Serialize;
use std::fmt::Write as _;

/// Everything found about a part.
pub struct Analysis<'a> {
    pub part: &'a Part,
    pub frame: Frame,
    pub solid: &'a BitGrid,
    pub surface: TriMesh,
    pub paint: Paint,
    pub survey: Survey,
    /// The direction that reaches most, which the collateral is of.
    pub best: Direction,
    pub damage: Damage,
    pub build: Direction,
    /// Voxels that stand by themselves along the build direction, and voxels of support.
    pub support: (usize, usize),
}

/// The summary, and `analysis.json`.
#[derive(Debug, Serialize)]
pub struct Record {
    schema: &'static str,
    part: String,
    sha256: String,
    tool: String,
    grid: Frame,
    part_mm3: f64,
    surface_mm2: f64,
    /// Space around the part within the grid that some direction reaches, and the rest of it.
    accessible_mm3: f64,
    inaccessible_mm3: f64,
    accessible_surface_mm2: f64,
    /// What of the part must go to reach all of the space from `collateral_direction`.
    collateral_mm3: f64,
    collateral_direction: Direction,
    collateral_pitch_mm: f64,
    build_direction: Direction,
    overhanging_surface_mm2: f64,
    self_supported_mm3: f64,
    support_mm3: f64,
    directions: Vec<DirectionRecord>,
    seconds: f64,
}

#[derive(Debug, Serialize)]
struct DirectionRecord {
    direction: Direction,
    accessible_mm3: f64,
    /// What no direction before it reaches.
    new_mm3: f64,
    surface_mm2: f64,
}

impl Analysis<'_> {
    pub fn record(&self, tool: &str, seconds: f64) -> Record {
        let voxel = self.frame.voxel_volume();
        let mm3 = |n: usize| n as f64 * voxel;
        let accessible = self.survey.accessible.count();
        let outside = self.frame.voxel_count() - self.solid.count();
        let directions = self.survey.reaches.iter().zip(&self.paint.by_direction);
        Record {
            schema: "hmplan-analysis-1",
            part: self.part.record.path.clone(),
            sha256: self.part.record.sha256.clone(),
            tool: tool.into(),
            grid: self.frame,
            part_mm3: mm3(self.solid.count()),
            surface_mm2: self.paint.area,
            accessible_mm3: mm3(accessible),
            inaccessible_mm3: mm3(outside - accessible),
            accessible_surface_mm2: self.paint.reached,
            collateral_mm3: mm3(self.damage.region.count()),
            collateral_direction: self.best,
            collateral_pitch_mm: self.damage.pitch,
            build_direction: self.build,
            overhanging_surface_mm2: self.paint.overhanging,
            self_supported_mm3: mm3(self.support.0),
            support_mm3: mm3(self.support.1),
            directions: directions
                .map(|(r, area)| DirectionRecord {
                    direction: r.direction,
                    accessible_mm3: mm3(r.voxels),
                    new_mm3: mm3(r.new_voxels),
                    surface_mm2: *area,
                })
                .collect(),
            seconds,
        }
    }
}

/// Writes the coloured surface and the record; of the record all but the time, which differs from
/// run to run.
pub fn write(
    destination: &Destination,
    analysis: &Analysis,
    tool: &str,
    ctx: &Ctx,
) -> Result<(), Failure> {
    let mut record =
        serde_json::to_value(analysis.record(tool, 0.0)).map_err(|e| Failure::Io(e.to_string()))?;
    if let Some(fields) = record.as_object_mut() {
        fields.remove("seconds");
    }
    let text = serde_json::to_string_pretty(&record).map_err(|e| Failure::Io(e.to_string()))?;
    let draft = destination.begin()?;
    draft.write(COLOURS, |out| analysis.paint.write_ply(&analysis.surface, out))?;
    draft.write(ANALYSIS, |out| writeln!(out, "{text}"))?;
    ctx.check()?;
    draft.publish()
}

/// The directions that reach most, this many in the table; all are in the record.
const SHOWN: usize = 10;

pub fn table(r: &Record) -> String {
    let mut out = String::new();
    let share = |part: f64, whole: f64| if whole > 0.0 { 100.0 * part / whole } else { 0.0 };
    let mut row = |name: &str, value: String| {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "{name:<13} {value}");
    };
    let cm3 = |mm3: f64| format!("{:.3} cm³", mm3 / 1000.0);
    let cm2 = |mm2: f64| format!("{:.2} cm²", mm2 / 100.0);
    let space = r.accessible_mm3 + r.inaccessible_mm3;
    row("part", format!("{}, surface {}", cm3(r.part_mm3), cm2(r.surface_mm2)));
    row(
        "accessible",
        format!(
            "{} = {:.1} % of the space around it; {} = {:.1} % of the surface",
            cm3(r.accessible_mm3),
            share(r.accessible_mm3, space),
            cm2(r.accessible_surface_mm2),
            share(r.accessible_surface_mm2, r.surface_mm2)
        ),
    );
    row("inaccessible", cm3(r.inaccessible_mm3));
    row(
        "collateral",
        format!(
            "{} to reach all of it from {} (found at {:.3} mm)",
            cm3(r.collateral_mm3),
            shown(r.collateral_direction),
            r.collateral_pitch_mm
        ),
    );
    let overhanging = cm2(r.overhanging_surface_mm2);
    row("overhanging", format!("{overhanging} when built along {}", shown(r.build_direction)));
    let (stands, support) = (cm3(r.self_supported_mm3), cm3(r.support_mm3));
    row("support", format!("{stands} stands by itself, {support} of support"));
    let mut best: Vec<&DirectionRecord> = r.directions.iter().collect();
    best.sort_by(|a, b| b.surface_mm2.total_cmp(&a.surface_mm2));
    for d in best.iter().take(SHOWN) {
        row(
            "direction",
            format!(
                "{}  {:5.1} % of the surface, {:5.1} % of the space",
                shown(d.direction),
                share(d.surface_mm2, r.surface_mm2),
                share(d.accessible_mm3, space)
            ),
        );
    }
    if best.len() > SHOWN {
        row("", format!("and {} more; --json lists all", best.len() - SHOWN));
    }
    let [x, y, z] = r.grid.dims;
    row("grid", format!("{x} × {y} × {z} voxels of {} mm", r.grid.pitch));
    row("time", format!("{:.1} s", r.seconds));
    out
}

fn shown(d: Direction) -> String {
    let [x, y, z] = d.vec().to_array();
    format!("({x:.3}, {y:.3}, {z:.3})")
}
