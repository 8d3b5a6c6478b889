use super::check::motions;
use super::interpret::{Gait, Motion};
use super::*;
use crate::base::Ctx;
use crate::machine::Shape;
use crate::toolpath::Replay;
use crate::toolpath::tests::{
    MACHINES, WORLDS, World, bosses, pocket, shoulder, tilted, tower, treads,
};
use crate::toolpath::{Toolpaths, for_unverified};

pub(super) fn paths(w: &World) -> Toolpaths {
    for_unverified(&w.job, &w.plan, &Ctx::quiet()).unwrap()
}

fn posted(w: &World) -> String {
    post(&w.job, &w.plan, &paths(w), "sha256:0").unwrap().text().to_string()
}

pub(super) fn report(w: &World, text: &str) -> CheckReport {
    check(text, &w.job, &w.plan, None, &Ctx::quiet()).unwrap()
}

pub(super) fn told(r: &CheckReport) -> String {
    r.findings.iter().map(|f| format!("{f}\n")).collect()
}

#[test]
fn every_world_passes_on_every_machine() {
    for machine in MACHINES {
        for (name, make) in WORLDS {
            let w = make(machine);
            let p = paths(&w);
            let program = post(&w.job, &w.plan, &p, "sha256:0").unwrap();
            let ctx = Ctx::quiet();
            let (r, checked) = check_program(program, &w.job, &w.plan, Some(&p), &ctx).unwrap();
            assert!(r.passed(), "{name} on {machine}:\n{}", told(&r));
            assert!(checked.is_some());
            for (f, p) in r.steps.iter().zip(p.all()) {
                assert!(f.time_s >= 0.9 * p.figures.time_s, "{name} on {machine}");
            }
        }
    }
}

/// Of a step what stood beside a wall, its stock, was once finished after the wall, under the holder.
#[test]
fn stock_is_taken_before_the_holder_comes_over_it() {
    let w = shoulder("generic-5axis");
    let r = report(&w, &posted(&w));
    assert!(r.passed(), "{}", told(&r));
}

/// The program is that of a tool whose holder begins far up; run with one that begins lower it meets nothing that stays.
#[test]
fn a_holder_in_what_is_still_to_be_cut_is_caught() {
    let mut w = bosses("generic-5axis");
    let text = posted(&w);
    assert!(report(&w, &text).passed());
    let name = w.plan.steps[0].tool.clone();
    let tool = w.job.cutters.iter_mut().find(|t| t.name == name).unwrap();
    for s in tool.sections.iter_mut().filter(|s| !s.active) {
        s.shape = Shape::Frustum { z0: 9.0, r0: 7.0, z1: 80.0, r1: 7.0 };
    }
    let r = report(&w, &text);
    assert!(
        !r.findings.is_empty() && r.findings.iter().all(|f| f.rule == Rule::Holder),
        "{}",
        told(&r)
    );
    // The bosses end at 36 mm: the holder comes on the second when the tip is 9 mm down in the first, with the first
    // move that ends so low, but for contact too shallow to be told.
    let replay = Replay::of(&w.job, &w.plan).unwrap();
    let motions = motions(&text, &w.job, &w.plan, &replay);
    let feeds: Vec<&Motion> = motions.iter().filter(|m| m.gait == Gait::Feed).collect();
    let first = feeds.iter().position(|m| m.line == r.findings[0].line).unwrap();
    let deepest = |some: &[&Motion]| some.iter().map(|m| m.to.z).fold(f64::INFINITY, f64::min);
    assert!(deepest(&feeds[..first]) > 26.0, "{}", deepest(&feeds[..first]));
    assert!(deepest(&feeds[..=first]) < 27.0, "{}", deepest(&feeds[..=first]));
}

/// The text with line `at` (from 1) replaced, or dropped for None.
fn with_line(text: &str, at: usize, new: Option<&str>) -> String {
    let lines =
        text.lines().enumerate().filter_map(|(i, l)| if i + 1 == at { new } else { Some(l) });
    lines.map(|l| format!("{l}\n")).collect()
}

/// Line numbers that satisfy `f`, from 1.
fn lines_where(text: &str, f: impl Fn(&str) -> bool) -> Vec<usize> {
    text.lines().enumerate().filter(|(_, l)| f(l)).map(|(i, _)| i + 1).collect()
}

/// The altered program breaks `rule`, first at one of `lines`.
fn caught(w: &World, text: &str, rule: Rule, lines: std::ops::RangeInclusive<usize>) {
    let r = report(w, text);
    let found = r.findings.iter().find(|f| f.rule == rule);
    assert!(found.is_some_and(|f| lines.contains(&f.line)), "{rule} in {lines:?}:\n{}", told(&r));
}

#[test]
fn a_missing_spindle_start_is_caught_at_the_first_cut() {
    let w = pocket("generic-5axis");
    let text = posted(&w);
    let at = lines_where(&text, |l| l.starts_with("M3 S"))[0];
    let first = lines_where(&text, |l| l.starts_with("G1 "))[0];
    caught(&w, &with_line(&text, at, None), Rule::Spindle, first - 1..=first - 1);
}

#[test]
fn extruder_codes_that_are_missing_are_caught() {
    let w = tower("generic-5axis");
    let text = posted(&w);
    for (code, after) in [("M72", 2), ("M73", 1), ("M74", 3), ("M75", 1)] {
        let at = lines_where(&text, |l| l == code)[3];
        caught(&w, &with_line(&text, at, None), Rule::Extruder, at..=at + after);
    }
    for code in ["M70", "M71"] {
        let at = lines_where(&text, |l| l == code)[0];
        caught(&w, &with_line(&text, at, None), Rule::Extruder, at..=at + 8);
    }
}

#[test]
fn a_moved_coordinate_is_caught_on_its_line() {
    let shift = |line: &str, letter: char, by: f64| {
        let words = line.split(' ').map(|word| match word.strip_prefix(letter) {
            Some(n) => format!("{letter}{:.3}", n.parse::<f64>().unwrap() + by),
            None => word.to_string(),
        });
        words.collect::<Vec<_>>().join(" ")
    };
    let w = pocket("generic-5axis");
    let text = posted(&w);
    let cuts = lines_where(&text, |l| l.starts_with('X') || l.starts_with("G1 X"));
    for at in [cuts[5], cuts[cuts.len() / 2], cuts[cuts.len() - 5]] {
        let line = text.lines().nth(at - 1).unwrap();
        let r = report(&w, &with_line(&text, at, Some(&shift(line, 'X', 20.0))));
        assert!(r.findings.iter().any(|f| f.line == at), "{line}:\n{}", told(&r));
    }
    let down = lines_where(&text, |l| l.starts_with('Z'));
    let at = down[down.len() / 2];
    let line = text.lines().nth(at - 1).unwrap();
    let low = with_line(&text, at, Some(&shift(line, 'Z', -20.0)));
    caught(&w, &low, Rule::Gouge, at..=at);

    let w = tower("generic-5axis");
    let text = posted(&w);
    let beads = lines_where(&text, |l| l.starts_with('X'));
    let at = beads[beads.len() / 2];
    let line = text.lines().nth(at - 1).unwrap();
    let away = with_line(&text, at, Some(&shift(line, 'X', 20.0)));
    caught(&w, &away, Rule::Astray, at..=at + 1);
}

#[test]
fn a_missing_retract_is_caught_at_the_rapid_that_follows() {
    let w = pocket("generic-5axis");
    let text = posted(&w);
    let ups = lines_where(&text, |l| l.starts_with("G0 Z"));
    let at = ups[ups.len() / 2];
    // Without the retract the next rapid crosses the work: its G0 went with the dropped line.
    let next = text.lines().nth(at).unwrap();
    assert!(next.starts_with('X') || next.starts_with('Y'), "{next}");
    let text = with_line(&with_line(&text, at, None), at, Some(&format!("G0 {next}")));
    caught(&w, &text, Rule::Rapid, at..=at);
}

#[test]
fn a_flipped_rotary_sign_is_caught_on_its_line() {
    for machine in MACHINES {
        let w = tilted(machine);
        let text = posted(&w);
        let chain = &w.job.machine.kinematics;
        let (a, c) = (chain.first.letter, chain.second.letter);
        let turns = lines_where(&text, |l| l.starts_with(&format!("G0 {a}")));
        assert_eq!(turns.len(), 2);
        let line = text.lines().nth(turns[0] - 1).unwrap();
        // Flip whichever of the two axes is not at zero or a half turn.
        let flip = |letter: char| {
            let words = line.split(' ').map(|word| match word.strip_prefix(letter) {
                Some(n) => format!("{letter}{:.4}", -n.parse::<f64>().unwrap()),
                None => word.to_string(),
            });
            words.collect::<Vec<_>>().join(" ")
        };
        let flipped = [flip(a), flip(c)].into_iter().filter(|f| f.as_str() != line);
        let mut noticed = 0;
        for f in flipped {
            let r = report(&w, &with_line(&text, turns[0], Some(&f)));
            let on_line = |x: &&Finding| {
                x.line == turns[0] && matches!(x.rule, Rule::Direction | Rule::Limits)
            };
            noticed += usize::from(r.findings.iter().find(on_line).is_some());
        }
        assert!(noticed > 0, "{machine}: {line}");
    }
}

#[test]
fn rotary_motion_outside_the_parking_height_is_caught() {
    let w = tilted("generic-5axis");
    let text = posted(&w);
    let turn = lines_where(&text, |l| {
        l.starts_with("G0 A") || l.starts_with("G0 B") || l.starts_with("G0 C")
    })[1];
    let park = lines_where(&text, |l| l.starts_with("G53"));
    let before = *park.iter().rev().find(|p| **p < turn).unwrap();
    let lower = text.lines().nth(before - 1).unwrap().replace("750", "700");
    caught(&w, &with_line(&text, before, Some(&lower)), Rule::Rotary, before..=turn);
}

#[test]
fn broken_text_is_caught_on_its_line() {
    let w = pocket("generic-5axis");
    let text = posted(&w);
    let at = lines_where(&text, |l| l.starts_with('X'))[4];
    let long = format!("(words{})", " words".repeat(60));
    for (line, rule) in [
        ("X1.2.3", Rule::Syntax),
        ("Xnan", Rule::Syntax),
        ("X99999999", Rule::Syntax),
        ("G1 X\u{e4}", Rule::Syntax),
        (long.as_str(), Rule::Syntax),
        ("G2 X1 Y1 I1", Rule::Modes),
        ("G91", Rule::Modes),
        ("E5", Rule::Modes),
        ("U1", Rule::Modes),
        ("M8", Rule::Modes),
        ("G1 Z1 M3", Rule::Syntax),
        ("X5000", Rule::Limits),
        ("M30", Rule::End),
    ] {
        caught(&w, &with_line(&text, at, Some(line)), rule, at..=at + 1);
    }
    let feed = lines_where(&text, |l| l.contains(" F"))[0];
    let line = text.lines().nth(feed - 1).unwrap();
    let bare = line.split(" F").next().unwrap().to_string();
    caught(&w, &with_line(&text, feed, Some(&bare)), Rule::Feed, feed..=feed);
    for modal in ["G21", "G90", "G94", "G17", "G54"] {
        let at = lines_where(&text, |l| l == modal)[0];
        assert!(!report(&w, &with_line(&text, at, None)).passed(), "{modal}");
    }
}

#[test]
fn a_truncated_program_is_no_program() {
    let w = tower("generic-5axis");
    let text = posted(&w);
    let half: String =
        text.lines().take(text.lines().count() / 2).map(|l| format!("{l}\n")).collect();
    let r = report(&w, &half);
    for rule in [Rule::End, Rule::Volume] {
        assert!(r.findings.iter().any(|f| f.rule == rule), "{rule}:\n{}", told(&r));
    }
    assert!(!report(&w, "").passed());
}

#[test]
fn a_program_of_another_plan_does_less_or_more_than_promised() {
    let (a, b) = (pocket("generic-5axis"), tower("generic-5axis"));
    assert!(!report(&a, &posted(&b)).passed());
    let w = tower("generic-5axis");
    let mut text = posted(&w);
    // One closed bead printed twice.
    let stops = lines_where(&text, |l| l == "M73");
    let next = |on: usize| *stops.iter().find(|l| **l > on).unwrap();
    let starts = lines_where(&text, |l| l == "M72");
    let on = *starts.iter().skip(1).find(|on| next(**on) > **on + 4).unwrap();
    let off = next(on);
    let lines: Vec<&str> = text.lines().collect();
    let again =
        [&lines[..off - 1], &lines[on..off - 1], &lines[on..off - 1], &lines[off - 1..]].concat();
    text = again.iter().map(|l| format!("{l}\n")).collect();
    let p = paths(&w);
    let r = check(&text, &w.job, &w.plan, Some(&p), &Ctx::quiet()).unwrap();
    assert!(r.findings.iter().any(|f| f.rule == Rule::Volume), "{}", told(&r));
}

#[test]
fn a_bead_that_ends_elsewhere_is_named_with_its_line() {
    let w = tower("generic-5axis");
    let text = posted(&w);
    let p = paths(&w);
    let judged = |text: &str| check(text, &w.job, &w.plan, Some(&p), &Ctx::quiet()).unwrap();
    assert!(judged(&text).passed(), "{}", told(&judged(&text)));
    // A corner moved by less than any length or volume would show.
    let starts = lines_where(&text, |l| l == "M72");
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    let at = (starts[starts.len() / 2]..).find(|i| lines[*i].contains('X')).unwrap();
    let x: f64 = lines[at].split(' ').find_map(|w| w.strip_prefix('X')).unwrap().parse().unwrap();
    lines[at] = lines[at].replace(&format!("X{x:.3}"), &format!("X{:.3}", x + 0.05));
    let moved: String = lines.iter().map(|l| format!("{l}\n")).collect();
    assert_ne!(moved, text);
    let r = judged(&moved);
    let found = r
        .findings
        .iter()
        .find(|f| f.rule == Rule::Volume)
        .unwrap_or_else(|| panic!("{}", told(&r)));
    assert_eq!(found.line, at + 1, "{}", found.message);
}

#[test]
fn a_missing_layer_is_caught_by_the_feed_of_the_next() {
    let w = treads("generic-5axis");
    let text = posted(&w);
    let height = |l: &str| {
        let z = l.split(' ').find_map(|w| w.strip_prefix('Z'))?;
        z.parse::<f64>().ok().filter(|_| !l.starts_with("G53"))
    };
    // Blocks of text by height; the third layer goes.
    let (mut z, mut heights) = (0.0, Vec::new());
    for l in text.lines() {
        z = height(l).unwrap_or(z);
        heights.push(z);
    }
    let laid = lines_where(&text, |l| l == "M72");
    let mut layers: Vec<f64> = laid.iter().map(|l| heights[*l]).collect();
    layers.dedup();
    let gone = layers[2];
    let bead = |i: usize| laid.iter().any(|on| *on == i + 1) && heights[i + 1] == gone;
    let mut skip = false;
    let kept = text.lines().enumerate().filter(|(i, l)| {
        skip |= bead(*i);
        let keep = !skip;
        skip &= *l != "M73";
        keep
    });
    let text: String = kept.map(|(_, l)| format!("{l}\n")).collect();
    let r = report(&w, &text);
    assert!(r.findings.iter().any(|f| f.rule == Rule::Feed), "{}", told(&r));
}

#[test]
fn what_the_machine_cannot_do_is_refused_with_the_step() {
    let mut w = tower("generic-5axis");
    let p = paths(&w);
    w.job.machine.control.dialect = "latin".into();
    assert!(matches!(post(&w.job, &w.plan, &p, ""), Err(PostError::UnknownDialect { .. })));
    let mut w = tower("generic-5axis");
    w.job.machine.kinematics.z.limits_mm = [700.0, 800.0];
    assert!(matches!(post(&w.job, &w.plan, &p, ""), Err(PostError::Posture { step: 0, .. })));
    let mut w = tower("generic-5axis");
    w.job.machine.control.max_feed_mm_min = 10.0;
    assert!(matches!(post(&w.job, &w.plan, &p, ""), Err(PostError::TooFast { step: 0, .. })));
    let mut w = tower("generic-5axis");
    w.job.machine.extruder = None;
    assert!(matches!(post(&w.job, &w.plan, &p, ""), Err(PostError::NoExtruder { step: 0, .. })));
}

#[test]
fn header_text_cannot_smuggle_code_into_the_program() {
    let w = pocket("generic-5axis");
    let p = paths(&w);
    let program = post(&w.job, &w.plan, &p, "x)\nG0 Z-100 (").unwrap();
    assert!(program.lines().all(|l| l.is_ascii()));
    assert!(report(&w, program.text()).passed());
    assert!(program.text().contains("PLAN NOT VERIFIED"));
}

#[test]
fn a_program_has_its_skeleton() {
    let w = crate::toolpath::tests::tiny("generic-5axis");
    let text = posted(&w);
    let motion = |l: &str| {
        let l = l.trim_start_matches("G0 ").trim_start_matches("G1 ");
        l.starts_with(['X', 'Y', 'Z']) || ["M72", "M73", "M74", "M75", "G4 P0.500"].contains(&l)
    };
    let skeleton: Vec<&str> =
        text.lines().filter(|l| !motion(l) && !l.contains(" min at full feed")).collect();
    let begin = [
        "(hmplan 0.1.0)",
        "(plan sha256:0)",
        "(PLAN NOT VERIFIED)",
        "(machine generic-5axis, dialect grblhal)",
        "(X Y Z: tip in machine coordinates with the head at zero, G54 offset zero)",
        "(table centre 0.000 0.000 0.000, pedestal 90.000 mm)",
        "(T1 ball-3x13 gauge 80.000 mm)",
        "(T10 short-nozzle gauge 12.000 mm)",
    ];
    let cut = ["T1 M6", "G43 H1", "G0 A0.0000 C0.0000", "M3 S16000", "G53 G0 Z750.000", "M5"];
    let print = ["T10 M6", "G43 H10", "G0 A0.0000 C0.0000", "M70", "G53 G0 Z750.000", "M71"];
    let up = "(direction 0.000000 0.000000 1.000000)";
    let want = [
        &begin[..],
        &["G21", "G90", "G94", "G17", "G54"],
        &["(step 1: subtractive, tool ball-3x13)", up, "G53 G0 Z750.000"],
        &cut,
        &["(step 2: additive, tool short-nozzle)", up, "G53 G0 Z750.000"],
        &print,
        &["G53 G0 Z750.000", "M30"],
    ]
    .concat();
    assert_eq!(skeleton, want);
}
