//! Short beads for what the lines of all layers stay away from: specks narrower than a bead.
//!
//! Method: of the voxels farther from every bead than the infill leaves any, one after the other gets
//! a bead as long as it is wide through its middle, in the layer nearest to it, unless a short bead
//! before it is within reach.
//!
//! Layers that would have no bead at all get one as well (`in_bare_layers`).
//!
//! Guarantees: with these beads every voxel of the region is within reach of one; each lies within
//! half its width of the centre of a voxel. Not guaranteed: that it stays inside the exact section, which
//! is narrower.

use super::infill::Line;
use super::mill::Work;
use super::process::Printing;
use crate::base::{DVec2, DVec3, ImagePlane};
use crate::voxel::{BitGrid, distance_within};

/// How far a voxel may be from the nearest bead, mm: half the distance between infill lines, a layer,
/// and a voxel's size.
fn reach(work: &Work, process: &Printing) -> f64 {
    process.width / process.infill.clamp(0.05, 1.0) / 2.0 + process.layer + work.frame.pitch
}

/// Short beads, each with the index of its layer, for what `lines` (with the heights of their
/// middles along the direction, mm) do not reach; `middles` are those of the layers.
pub(super) fn specks<'a>(
    work: &Work,
    process: &Printing,
    plane: &ImagePlane,
    middles: &[f64],
    lines: impl Iterator<Item = (f64, &'a Line)>,
) -> Vec<(usize, Line)> {
    let (frame, region) = (work.frame, &work.step.region);
    let mut laid = BitGrid::new(frame.dims);
    for (height, line) in lines {
        for ends in line.windows(2) {
            let n = (ends[0].distance(ends[1]) / (frame.pitch / 2.0)).ceil().max(1.0);
            let at = |i: usize| ends[0].lerp(ends[1], i as f64 / n);
            let points = (0..=n as usize).map(|i| plane.world(at(i), height));
            points.filter_map(|p| frame.voxel_at(p)).for_each(|v| laid.set(v, true));
        }
    }
    let reach = reach(work, process);
    let far = region.minus(&distance_within(&laid, reach / frame.pitch));
    let mut near: Vec<DVec3> = Vec::new();
    let mut short = Vec::new();
    for p in far.iter_ones().map(|v| frame.center(v)) {
        if near.iter().any(|q| q.distance(p) <= reach) {
            continue;
        }
        near.push(p);
        let (at, height) = (plane.across(p), plane.height(p));
        let half = DVec2::new(process.width / 2.0, 0.0);
        let away = |k: &usize| (middles[*k] - height).abs();
        let layer = (0..middles.len()).min_by(|a, b| away(a).total_cmp(&away(b)));
        short.extend(layer.map(|k| (k, vec![at - half, at + half])));
    }
    short
}

/// Short beads in layers that have none though the region is wider than two beads there, each with
/// the index of its layer: where the exact section is thinner than a bead, a plan's voxels are not.
/// Without them the next layer's beads would hang over a gap.
pub(super) fn in_bare_layers(
    work: &Work,
    process: &Printing,
    plane: &ImagePlane,
    middles: &[f64],
    is_bare: impl Fn(usize) -> bool,
) -> Vec<(usize, Line)> {
    let (frame, region) = (work.frame, &work.step.region);
    if !(0..middles.len()).any(&is_bare) {
        return Vec::new();
    }
    let inside = |p: DVec3| frame.voxel_at(p).is_some_and(|v| region.get(v));
    let across = [plane.u, plane.v].map(|a| process.width * a);
    let wide = |p: DVec3| across.iter().all(|a| inside(p + *a) && inside(p - *a));
    // A body's exact face may lie half a voxel inside its voxels': that far there is certainly something.
    let along = frame.pitch * plane.d;
    let half = frame.pitch / 2.0 * plane.d.abs().element_sum();
    let mut nearest: Vec<Option<(f64, DVec3)>> = vec![None; middles.len()];
    for p in region.iter_ones().map(|v| frame.center(v)) {
        let z = plane.height(p);
        let reach = |side: DVec3| if inside(p + side) { half } else { 0.0 };
        let (low, high) = (z - reach(-along), z + reach(along));
        let first = middles.partition_point(|m| *m < low);
        for k in first..middles.partition_point(|m| *m <= high) {
            let away = (middles[k] - z).abs();
            if is_bare(k) && nearest[k].is_none_or(|(d, _)| away < d) && wide(p) {
                nearest[k] = Some((away, p));
            }
        }
    }
    let half_bead = DVec2::new(process.width / 2.0, 0.0);
    let bead = |p: DVec3| vec![plane.across(p) - half_bead, plane.across(p) + half_bead];
    let found = nearest.into_iter().enumerate();
    found.filter_map(|(k, at)| at.map(|(_, p)| (k, bead(p)))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Ctx;
    use crate::machine::ToolKind;
    use crate::plan::Job;
    use crate::toolpath::tests::tower;

    /// Asks about a step that prints just what a condition says of the tower's voxels.
    fn with_region<R>(
        is_printed: impl Fn([usize; 3]) -> bool + Sync,
        ask: impl Fn(&Job, &Work, &Printing, &ImagePlane) -> R,
    ) -> R {
        let w = tower("generic-5axis");
        let (job, mut step) = (&w.job, w.plan.steps[0].clone());
        let tool = job.machine.tools_of(ToolKind::Additive)[0].clone();
        step.region = BitGrid::from_fn(job.frame.dims, is_printed);
        let none = BitGrid::new(job.frame.dims);
        let work = Work {
            job,
            frame: &job.frame,
            step: &step,
            tool: &tool,
            before: &none,
            after: &none,
            fixed: &[],
            laid: &none,
            surfaces: &[none.clone(), none.clone()],
            ctx: &Ctx::quiet(),
        };
        let extruder = job.machine.extruder.as_ref().unwrap();
        let process = Printing::of(&job.machine, extruder, &tool);
        ask(job, &work, &process, &step.direction.image_plane())
    }

    #[test]
    fn what_is_far_from_every_bead_gets_one_and_the_rest_none() {
        with_region(
            |v| v[1] == 20 && v[2] == 30,
            |job, work, process, plane| {
                let (n, apart) = (job.frame.dims[0], 12);
                let at = |x: usize| plane.across(job.frame.center([x, 20, 30]));
                let z = plane.height(job.frame.center([0, 20, 30]));
                let middles = [z - 0.3, z - 0.1, z + 0.1001];
                let made =
                    |line: &Line| specks(work, process, plane, &middles, [(z, line)].into_iter());
                // A bead along the first voxels leaves those beyond its reach.
                let long = vec![at(0), at(apart)];
                let beads = made(&long);
                let reach = reach(work, process);
                let all = |x: usize| {
                    let far = |line: &Line| line.iter().all(|p| p.distance(at(x)) > reach);
                    x > apart && far(&long) && beads.iter().all(|(_, line)| far(line))
                };
                assert!(!beads.is_empty() && !(0..n).any(all), "{beads:?}");
                let beyond = |line: &Line| line.iter().all(|p| p.x >= at(apart).x);
                assert!(beads.iter().all(|(k, line)| *k == 1 && beyond(line)));
                assert!(made(&vec![at(0), at(n - 1)]).is_empty());
            },
        );
    }

    #[test]
    fn a_layer_without_beads_gets_one_where_the_region_is_wide() {
        let wide = |v: [usize; 3]| v.iter().all(|c| (10..20).contains(c));
        let rod = |v: [usize; 3]| v[0] == 5 && v[1] == 5 && (20..24).contains(&v[2]);
        with_region(
            |v| wide(v) || rod(v),
            |job, work, process, plane| {
                let z = |k: usize| plane.height(job.frame.center([0, 0, k]));
                let end = z(19) + 0.49 * job.frame.pitch;
                // Under the body, in it, in its last voxels' far half, on the thin rod, over all.
                let middles = [z(9), z(12) + 0.01, z(15), end, z(21), z(25)];
                let made = |is_bare: &dyn Fn(usize) -> bool| {
                    in_bare_layers(work, process, plane, &middles, is_bare)
                };
                let all = made(&|_| true);
                let layers: Vec<usize> = all.iter().map(|(k, _)| *k).collect();
                assert_eq!(layers, [1, 2], "{all:?}");
                for (_, line) in &all {
                    let p = plane.world((line[0] + line[1]) / 2.0, z(15));
                    assert!(job.frame.voxel_at(p).is_some_and(wide), "{all:?}");
                }
                assert_eq!(made(&|k| k == 2).len(), 1);
                assert!(made(&|_| false).is_empty());
            },
        );
    }
}
