//! The rules page read aloud: plain loops over all voxels, all tips and all obstacle points.
//!
//! It knows none of the verifier's methods; it shares the grid, tool and workholding types and the
//! rounding in the plan's favour.

use crate::base::{DVec2, DVec3};
use crate::machine::{BaseKind, Holding, HoldingMode, Tool};
use crate::plan::{Job, Plan, Step, StepKind};
use crate::verify::{ROUNDING_MM, Rule};
use crate::voxel::BitGrid;
use std::collections::BTreeSet;

/// A rule, its step, and how many voxels (or faults) break it.
pub type Finding = (Rule, Option<usize>, usize);

type Voxel = [i64; 3];
type Solid = BTreeSet<Voxel>;

fn set(g: &BitGrid) -> Solid {
    g.iter_ones().map(|v| v.map(|c| c as i64)).collect()
}

fn center(job: &Job, v: Voxel) -> DVec3 {
    let c = DVec3::new(v[0] as f64 + 0.5, v[1] as f64 + 0.5, v[2] as f64 + 0.5);
    job.frame.origin + c * job.frame.pitch
}

/// Every rule that a plan breaks, in order of the steps and the page.
pub fn findings(job: &Job, plan: &Plan) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut state = set(&job.initial);
    let mut removed = Solid::new();
    let mut held: Option<(usize, Vec<DVec3>)> = None;
    for (i, step) in plan.steps.iter().enumerate() {
        let region = set(&step.region);
        let before = state.clone();
        match step.kind {
            StepKind::Subtractive => {
                state.retain(|v| !region.contains(v));
                removed.extend(&region);
            }
            StepKind::Additive => state.extend(&region),
        }
        if held.as_ref().is_none_or(|(h, _)| *h != step.holding) {
            held = Some((step.holding, fixed_points(job, plan, step, &before)));
        }
        let fixed = &held.as_ref().unwrap().1;
        found.push((Rule::Content, Some(i), content(step, &region, &before)));
        let tool = job.tool(&step.tool).unwrap();
        let access = match step.kind {
            StepKind::Subtractive => subtractive(job, step, tool, &region, &state, fixed),
            StepKind::Additive => additive(job, step, tool, &region, &before, fixed),
        };
        found.push((Rule::ToolAccess, Some(i), access));
        if step.kind == StepKind::Additive {
            let n = region.iter().filter(|x| !carried(job, step, **x, &region, &before)).count();
            found.push((Rule::Support, Some(i), n));
        }
        found.push((Rule::Stability, Some(i), loose(job, &state)));
        found.push((Rule::Machine, Some(i), machine(job, plan, step)));
    }
    found.push((Rule::End, None, end(job, &state, &removed)));
    found.retain(|f| f.2 > 0);
    found
}

fn fixed_points(job: &Job, plan: &Plan, step: &Step, before: &Solid) -> Vec<DVec3> {
    if job.rules.base == BaseKind::None {
        return Vec::new();
    }
    let mut state = BitGrid::new(job.frame.dims);
    before.iter().for_each(|v| state.set(v.map(|c| c as usize), true));
    let holding = plan.holdings[step.holding];
    let contact = match step.holding {
        0 => job.base_contact(),
        _ => holding.contact(&state, &job.frame, job.rules.grip_mm),
    };
    job.machine.workholding.obstacle_points(&holding, &contact, &job.frame)
}

fn content(step: &Step, region: &Solid, before: &Solid) -> usize {
    let wrong = region.iter().filter(|v| match step.kind {
        StepKind::Subtractive => !before.contains(*v),
        StepKind::Additive => before.contains(*v),
    });
    if region.is_empty() { 1 } else { wrong.count() }
}

fn subtractive(
    job: &Job,
    step: &Step,
    tool: &Tool,
    region: &Solid,
    after: &Solid,
    fixed: &[DVec3],
) -> usize {
    let plane = step.direction.image_plane();
    let obstacles: Vec<(DVec2, f64)> = after
        .iter()
        .map(|v| center(job, *v))
        .chain(fixed.iter().copied())
        .map(|p| (plane.across(p), plane.height(p)))
        .collect();
    let s = if step.direction.is_grid_axis() { job.frame.pitch } else { job.frame.pitch / 2.0 };
    let origin = plane.across(center(job, [0, 0, 0]));
    let radius = tool.active_radius();
    let reachable = |x: Voxel| {
        let p = center(job, x);
        let (at, z) = (plane.across(p), plane.height(p));
        let near = (at - origin) / s;
        let n = (radius / s).ceil() as i64 + 1;
        let (ci, cj) = (near.x.round() as i64, near.y.round() as i64);
        (ci - n..=ci + n).any(|i| {
            (cj - n..=cj + n).any(|j| {
                let tip = origin + DVec2::new(i as f64, j as f64) * s;
                let rho = tip.distance(at);
                if rho > radius + ROUNDING_MM {
                    return false;
                }
                let tip_z = z - tool.active_lower_surface((rho - ROUNDING_MM).max(0.0));
                tip_z.is_finite()
                    && !obstacles.iter().any(|(o, oz)| {
                        let f = tool.lower_surface(o.distance(tip) + ROUNDING_MM);
                        *oz > tip_z + f + ROUNDING_MM
                    })
            })
        })
    };
    region.iter().filter(|x| !reachable(**x)).count()
}

fn additive(
    job: &Job,
    step: &Step,
    tool: &Tool,
    region: &Solid,
    before: &Solid,
    fixed: &[DVec3],
) -> usize {
    let plane = step.direction.image_plane();
    let collides = |x: Voxel| {
        let p = center(job, x);
        let (at, z) = (plane.across(p), plane.height(p));
        let lower = region.iter().map(|v| center(job, *v)).filter(|q| plane.height(*q) < z);
        let solid = before.iter().map(|v| center(job, *v));
        solid.chain(fixed.iter().copied()).chain(lower).any(|o| {
            let rho = plane.across(o).distance(at) + ROUNDING_MM;
            tool.sections.iter().any(|s| {
                let dip = match s.shape.lower_surface(0.0) == 0.0 {
                    true => job.rules.nozzle_dip_mm,
                    false => 0.0,
                };
                plane.height(o) > z + s.shape.lower_surface(rho) + dip + ROUNDING_MM
            })
        })
    };
    region.iter().filter(|x| collides(**x)).count()
}

fn neighbours(v: Voxel) -> impl Iterator<Item = Voxel> {
    (0..27)
        .map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1])
        .filter(|o| *o != [0, 0, 0])
        .map(move |o| [v[0] + o[0], v[1] + o[1], v[2] + o[2]])
}

fn carried(job: &Job, step: &Step, x: Voxel, region: &Solid, before: &Solid) -> bool {
    let h = job.frame.pitch;
    let solid = |v: &Voxel| before.contains(v) || region.contains(v);
    let height = |v: Voxel| step.direction.dot(center(job, v));
    let below = |v: &Voxel, of: Voxel| height(*v) < height(of) - 1e-6 * h;
    let steep = |v: Voxel| {
        let lean = center(job, x) - center(job, v);
        let angle = (step.direction.dot(lean) / lean.length()).clamp(-1.0, 1.0).acos();
        angle.to_degrees() <= job.rules.overhang_deg + 1e-6
    };
    let from_above = step.holding == 0 && step.direction == crate::base::Direction::Z;
    if from_above && (center(job, x).z - h / 2.0).abs() <= 1e-6 * h {
        return true;
    }
    neighbours(x)
        .filter(|a| solid(a) && below(a, x))
        .any(|a| steep(a) || neighbours(a).filter(|b| solid(b) && below(b, a)).any(steep))
}

fn flood(state: &Solid, seeds: Vec<Voxel>) -> Solid {
    let mut seen: Solid = seeds.iter().copied().collect();
    let mut open = seeds;
    while let Some(v) = open.pop() {
        for n in neighbours(v) {
            let apart = (0..3).filter(|a| n[*a] != v[*a]).count();
            if apart < 3 && state.contains(&n) && seen.insert(n) {
                open.push(n);
            }
        }
    }
    seen
}

fn loose(job: &Job, state: &Solid) -> usize {
    match job.rules.holding {
        HoldingMode::Base => {
            let gripped =
                |v: &&Voxel| Holding::AS_CLAMPED.height(center(job, **v)) <= job.rules.grip_mm;
            let seeds: Vec<Voxel> = state.iter().filter(gripped).copied().collect();
            state.len() - flood(state, seeds).len()
        }
        HoldingMode::Refixture => {
            let largest = state.iter().map(|v| flood(state, vec![*v]).len()).max();
            state.len() - largest.unwrap_or(0)
        }
    }
}

fn machine(job: &Job, plan: &Plan, step: &Step) -> usize {
    let used_anew = job.rules.holding == HoldingMode::Base && step.holding != 0;
    let up = plan.holdings[step.holding].up;
    used_anew as usize + !job.machine.can_point(up, step.direction) as usize
}

/// Voxels of residual when there are too many, else 0.
fn end(job: &Job, state: &Solid, removed: &Solid) -> usize {
    let (initial, target) = (set(&job.initial), set(&job.target));
    let reused: Vec<Voxel> =
        initial.iter().filter(|v| !removed.contains(*v) && target.contains(*v)).copied().collect();
    let residual = state
        .symmetric_difference(&target)
        .filter(|x| {
            !reused.iter().any(|r| {
                center(job, **x).distance(center(job, *r)) <= job.rules.tolerance_mm + ROUNDING_MM
            })
        })
        .count();
    let fits = residual == 0 || residual as f64 / target.len() as f64 <= job.rules.deviation;
    if fits { 0 } else { residual }
}
