//! Programs with one thing wrong: what an oracle of plain loops calls harmful, the check finds.
//!
//! `HMPLAN_MUTATIONS` sets how many programs are altered; 150 when it does not.

use super::interpret::{Gait, Motion, Setting, run};
use super::tests::{paths, report, told};
use super::*;
use crate::base::{DVec3, ImagePlane};
use crate::machine::{AxisValues, RotaryAngles, Tool};
use crate::plan::StepKind;
use crate::toolpath::tests::{MACHINES, Make, WORLDS, World};
use crate::toolpath::{End, Replay};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus as Random;
use std::collections::BTreeMap;

/// A program that passes, and what the oracle knows of it.
struct Sound {
    world: World,
    replay: Replay,
    lines: Vec<String>,
    motions: Vec<Motion>,
}

impl Sound {
    fn new(make: fn(&str) -> World, machine: &str) -> Sound {
        let world = make(machine);
        let text = post(&world.job, &world.plan, &paths(&world), "sha256:0").unwrap();
        let replay = Replay::of(&world.job, &world.plan).unwrap();
        let motions = motions(&world, &replay, text.text());
        assert!(report(&world, text.text()).passed());
        Sound { lines: text.lines().map(String::from).collect(), world, replay, motions }
    }
}

fn motions(w: &World, replay: &Replay, text: &str) -> Vec<Motion> {
    let placements: Vec<_> = w
        .plan
        .steps
        .iter()
        .zip(&replay.contact_center)
        .map(|(s, c)| w.job.machine.placement(&w.plan.holdings[s.holding], *c))
        .collect();
    run(text, &Setting { job: &w.job, plan: &w.plan, placements: &placements }).motions
}

/// One alteration: the line (from 1) and the new text.
fn mutate(s: &Sound, rng: &mut Random) -> (usize, &'static str, Vec<String>) {
    let mut lines = s.lines.clone();
    let mut pick = |f: &dyn Fn(&str) -> bool| {
        let fit: Vec<usize> = (0..s.lines.len()).filter(|i| f(&s.lines[*i])).collect();
        fit.get(rng.random_range(0..fit.len().max(1))).copied()
    };
    let moves = |l: &str| {
        let l = l.trim_start_matches("G0 ").trim_start_matches("G1 ");
        l.starts_with(['X', 'Y', 'Z'])
    };
    let turns = format!("G0 {}", s.world.job.machine.kinematics.first.letter);
    let kind = pick(&|_| true).map_or(0, |i| i % 5);
    let at = match kind {
        0 => pick(&moves),
        1 => pick(&|l| l.starts_with("G0 Z")),
        2 => pick(&|l| l.starts_with("M3 ") || l == "M72" || l == "M73"),
        3 => pick(&|l| moves(l) || l.starts_with('M')),
        _ => pick(&|l| l.starts_with(&turns)),
    };
    let at = at.or_else(|| pick(&moves)).unwrap();
    let name = match kind {
        1 | 2 => {
            lines.remove(at);
            // Every other time the rapid that follows stays one.
            if kind == 1 && at % 2 == 0 && lines[at].starts_with(['X', 'Y']) {
                lines[at] = format!("G0 {}", lines[at]);
            }
            ["retract removed", "code removed"][kind - 1]
        }
        3 if at + 1 < lines.len() => {
            lines.swap(at, at + 1);
            "lines swapped"
        }
        4 if lines[at].starts_with(&turns) => {
            // Either of the two words, by turns.
            let mut words: Vec<String> = lines[at].split(' ').map(String::from).collect();
            let k = 1 + at % 2;
            let value: f64 = words[k][1..].parse().unwrap();
            words[k] = format!("{}{:.4}", &words[k][..1], -value);
            lines[at] = words.join(" ");
            "sign flipped"
        }
        _ => {
            let by = rng.random_range(2.0..15.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            let words: Vec<String> = lines[at].split(' ').map(String::from).collect();
            let k = words.iter().position(|w| w.starts_with(['X', 'Y', 'Z']));
            if let Some(k) = k {
                let mut words = words;
                let value: f64 = words[k][1..].parse().unwrap();
                words[k] = format!("{}{:.3}", &words[k][..1], value + by);
                lines[at] = words.join(" ");
            }
            "coordinate changed"
        }
    };
    (at + 1, name, lines)
}

/// Whether spindle or module are in the wrong state at some motion: word by word.
fn wrong_state(s: &Sound, lines: &[String]) -> bool {
    let (mut spindle, mut on, mut open, mut drawn) = (false, false, false, false);
    let (mut step, mut feed) = (0usize, false);
    let turns = format!("G0 {}", s.world.job.machine.kinematics.first.letter);
    let mut wrong = false;
    for l in lines {
        match l.as_str() {
            "M5" => spindle = false,
            "M70" => open = true,
            "M71" => open = false,
            "M72" => on = true,
            "M73" => on = false,
            "M74" => drawn = true,
            "M75" => drawn = false,
            l if l.starts_with("M3 ") => spindle = true,
            l if l.ends_with("M6") => (step, feed) = (step + 1, false),
            _ => {}
        }
        if l.starts_with("G0") || l.starts_with("G53") {
            feed = false;
        }
        feed |= l.starts_with("G1");
        let moves = feed && l.contains(['X', 'Y', 'Z']) && !l.starts_with('(');
        let kind = step.checked_sub(1).and_then(|i| s.world.plan.steps.get(i)).map(|s| s.kind);
        wrong |= moves
            && match kind {
                Some(StepKind::Subtractive) => !spindle,
                Some(StepKind::Additive) => !open || on == drawn,
                None => true,
            };
        wrong |= l.starts_with(&turns) && (spindle || on);
    }
    wrong || spindle || on || open
}

/// Points of the motion, 0.2 mm apart.
fn along(m: &Motion) -> impl Iterator<Item = DVec3> + use<> {
    let (from, to) = (m.from.unwrap_or(m.to), m.to);
    let n = (from.distance(to) / 0.2).ceil().max(1.0) as usize;
    (0..=n).map(move |i| from.lerp(to, i as f64 / n as f64))
}

fn alike(a: &Motion, b: &Motion) -> bool {
    let near = |p: Option<DVec3>, q: Option<DVec3>| match (p, q) {
        (Some(p), Some(q)) => p.distance(q) < 1e-6,
        (p, q) => p.is_none() && q.is_none(),
    };
    a.gait == b.gait && a.step == b.step && near(a.from, b.from) && near(Some(a.to), Some(b.to))
}

/// Whether the rotary axes of some block leave the tool pointing elsewhere than its step wants.
fn points_away(s: &Sound, lines: &[String]) -> bool {
    let (job, plan) = (&s.world.job, &s.world.plan);
    let chain = &job.machine.kinematics;
    let turns = format!("G0 {}", chain.first.letter);
    let mut step = 0usize;
    lines.iter().any(|l| {
        step += usize::from(l.ends_with("M6"));
        let words: Vec<&str> = l.split(' ').collect();
        let of = step.checked_sub(1).and_then(|i| plan.steps.get(i));
        let Some(of) = of.filter(|_| l.starts_with(&turns) && words.len() == 3) else {
            return false;
        };
        let [first_deg, second_deg] = [1, 2].map(|k| words[k][1..].parse::<f64>().unwrap());
        let axes = AxisValues::new(DVec3::ZERO, RotaryAngles { first_deg, second_deg });
        let center = s.replay.contact_center[step - 1];
        let placement = job.machine.placement(&plan.holdings[of.holding], center);
        let (_, d) = chain.tip(&placement, axes, 0.0);
        d.vec().angle_between(of.direction.vec()) > 1e-3
    })
}

/// How deep inside a tool that stands at `tip` a point lies, mm; negative outside.
fn depth(tool: &Tool, plane: &ImagePlane, tip: DVec3, p: DVec3) -> f64 {
    let rho = plane.across(p).distance(plane.across(tip));
    let z = plane.height(p) - plane.height(tip);
    let edge = End::of(tool).map_or(f64::NEG_INFINITY, |e| -e.distance(rho, z));
    // Shank and holder: how far the point stands over their lower surface.
    let over = if rho > tool.active_radius() { z - tool.lower_surface(rho) } else { edge };
    edge.max(over)
}

/// Whether what is swept is off by more than the plan's tolerance: new motions run into what stays,
/// beads lie away from the region, or missing cuts leave a lump.
fn wrong_motion(s: &Sound, after: &[Motion]) -> bool {
    let w = &s.world;
    let (h, tolerance) = (w.job.frame.pitch, w.job.rules.tolerance_mm);
    let n = s.motions.iter().zip(after).take_while(|(a, b)| alike(a, b)).count();
    let tail = s.motions[n..].iter().rev().zip(after[n..].iter().rev());
    let m = tail.take_while(|(a, b)| alike(a, b)).count();
    let (gone, new) = (&s.motions[n..s.motions.len() - m], &after[n..after.len() - m]);
    let points = |grid: &crate::voxel::BitGrid| -> Vec<DVec3> {
        grid.boundary().iter_ones().map(|v| w.job.frame.center(v)).collect()
    };
    for m in new {
        let step = &w.plan.steps[m.step];
        let plane = step.direction.image_plane();
        let tool = w.job.tool(&step.tool).unwrap();
        let cuts = step.kind == StepKind::Subtractive && m.gait != Gait::Rapid;
        let solid = points(&s.replay.states[m.step + usize::from(cuts)]);
        // A voxel's centre lies half a pitch under the surface; what is found at samples half a
        // pitch apart is a quarter less deep. A rapid may touch nothing at all.
        let slack = match (m.gait, cuts) {
            (Gait::Rapid, _) => h / 4.0,
            (_, true) => tolerance - h / 2.0 + h / 4.0,
            // Beads ride on what stands, staircase and all.
            (_, false) => 2.0 * h,
        };
        let hit = |tip: DVec3| solid.iter().any(|p| depth(tool, &plane, tip, *p) > slack);
        let up = m.from.is_some_and(|f| {
            plane.across(m.to - f).length() < 0.01 && plane.height(m.to - f) >= 0.0
        });
        if !up && along(m).any(hit) {
            return true;
        }
        let away = |tip: DVec3| {
            let middle = tip - step.direction.vec() * (tool.process.layer_mm / 2.0);
            let near = |v| w.job.frame.center(v).distance(middle) < 3.0 * h;
            m.gait == Gait::Deposit && !step.region.iter_ones().any(near)
        };
        if along(m).any(away) {
            return true;
        }
    }
    // What the missing cuts swept and no other cut sweeps.
    let slack = tolerance + h / 4.0;
    let sweeps = |m: &Motion, p: DVec3, slack: f64| {
        let step = &w.plan.steps[m.step];
        let plane = step.direction.image_plane();
        let tool = w.job.tool(&step.tool).unwrap();
        m.gait == Gait::Feed
            && along(m).any(|tip| {
                let rho = (plane.across(p).distance(plane.across(tip)) - slack).max(0.0);
                plane.height(tip) + tool.active_lower_surface(rho) <= plane.height(p) + slack
            })
    };
    let mut left = 0;
    for (i, step) in w.plan.steps.iter().enumerate() {
        if step.kind == StepKind::Additive || !gone.iter().any(|m| m.step == i) {
            continue;
        }
        for v in step.region.iter_ones() {
            let p = w.job.frame.center(v);
            let lost = gone.iter().any(|m| m.step == i && sweeps(m, p, 0.0));
            let kept = || after.iter().any(|m| m.step == i && sweeps(m, p, slack));
            left += usize::from(lost && !kept());
        }
    }
    // As many as make a lump; fewer are corners of the staircase.
    left >= 8
}

#[test]
fn harmful_mutations_are_caught_with_their_line() {
    let count = std::env::var("HMPLAN_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(150);
    let on = |make: &(&str, Make), machine: &str| Sound::new(make.1, machine);
    let mut sound: Vec<Sound> = WORLDS.iter().map(|w| on(w, MACHINES[0])).collect();
    sound.extend(MACHINES[1..].iter().map(|machine| on(&WORLDS[2], machine)));
    let mut rng = Random::seed_from_u64(7);
    let (mut harmful, mut caught, mut on_line) = (0, 0, 0);
    let mut kinds: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    let mut escaped = Vec::new();
    for i in 0..count {
        let s = &sound[i % sound.len()];
        let (at, name, lines) = mutate(s, &mut rng);
        let text = lines.join("\n") + "\n";
        let r = report(&s.world, &text);
        let after = motions(&s.world, &s.replay, &text);
        let harm = points_away(s, &lines) || wrong_state(s, &lines) || wrong_motion(s, &after);
        let tally = kinds.entry(name).or_default();
        tally[0] += 1;
        tally[1] += usize::from(harm);
        tally[2] += usize::from(!r.passed());
        caught += usize::from(!r.passed());
        if !harm {
            continue;
        }
        harmful += 1;
        let what = format!("mutation {i}, {name} at line {at}: {}", s.lines[at - 1]);
        // The line itself, or the first motion after it that does the harm.
        let next = (at..lines.len()).find(|k| lines[*k].starts_with("G1")).unwrap_or(at) + 1;
        let near = r.findings.iter().any(|f| f.line + 3 >= at && f.line <= next.max(at + 6));
        on_line += usize::from(near);
        if r.passed() {
            escaped.push(format!("{what}: nothing was found"));
        } else if !near && !r.findings.iter().any(|f| f.rule == Rule::Volume) {
            escaped.push(format!("{what}:\n{}", told(&r)));
        }
    }
    println!("{count} programs: {harmful} harmful, {caught} caught, {on_line} at their line");
    println!("of each kind, how many, harmful, caught: {kinds:?}");
    assert!(escaped.is_empty(), "{} escaped:\n{}", escaped.len(), escaped.join("\n"));
    // Of 300 it is 132: most retracts that can be removed lead over what is cut already.
    assert!(harmful >= count / 3, "only {harmful} of {count} do harm: the oracle is blind");
}
