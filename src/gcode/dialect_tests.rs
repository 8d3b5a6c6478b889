//! Every dialect's programs pass the check, and a reader that knows nothing of the writer.

use super::tests::{paths, report, told};
use super::*;
use crate::base::DVec3;
use crate::machine::Writing;
use crate::mesh::TriMesh;
use crate::plan::StepKind;
use crate::toolpath::tests::{WORLDS, World, world};

const DIALECTS: [&str; 6] = ["rs274", "linuxcnc", "grblhal", "rrf", "fanuc", "mx220"];

fn posted(make: fn(&str) -> World, dialect: &str, post_as: Writing) -> (World, String) {
    let mut w = make("generic-5axis");
    w.job.machine.control.dialect = dialect.into();
    w.job.machine.control.post = post_as;
    let text = post(&w.job, &w.plan, &paths(&w), "sha256:0").unwrap().text().to_string();
    (w, text)
}

#[test]
fn every_dialect_passes_its_check() {
    assert_eq!(Dialect::names().collect::<Vec<_>>(), DIALECTS);
    for dialect in DIALECTS {
        for (name, make) in WORLDS {
            let (w, text) = posted(make, dialect, Writing::default());
            let p = paths(&w);
            let r = check(&text, &w.job, &w.plan, Some(&p), &crate::base::Ctx::quiet()).unwrap();
            assert!(r.passed(), "{name} for {dialect}:\n{}", told(&r));
            let longest = text.lines().map(str::len).max().unwrap();
            assert!(longest <= Dialect::named(dialect).unwrap().longest_line);
            assert!(text.is_ascii() && !text.contains('\r'));
            assert!(text.contains("plan sha256:0") && text.contains(" gauge "));
        }
    }
}

#[test]
fn a_program_of_another_dialect_does_not_pass() {
    for (of, for_) in [("rrf", "grblhal"), ("grblhal", "rrf"), ("linuxcnc", "grblhal")] {
        let (mut w, text) = posted(WORLDS[1].1, of, Writing::default());
        w.job.machine.control.dialect = for_.into();
        assert!(!report(&w, &text).passed(), "{of} as {for_}");
    }
}

#[test]
fn numbers_digits_and_offsets_are_as_asked_for() {
    let ask = Writing {
        work_offset: 56,
        line_numbers: Some(true),
        linear_digits: Some(4),
        rotary_digits: Some(5),
        arcs: false,
    };
    for dialect in ["linuxcnc", "rrf"] {
        let (w, text) = posted(WORLDS[2].1, dialect, ask);
        assert!(report(&w, &text).passed(), "{dialect}:\n{}", told(&report(&w, &text)));
        let blocks = text.lines().filter(|l| !l.starts_with(['(', ';']));
        for (i, b) in blocks.enumerate() {
            assert!(b.starts_with(&format!("N{} ", (i as u32 % 9999 + 1) * 10)), "{i}: {b}");
        }
        let digits = |letter: char| {
            let word =
                text.split_whitespace().find(|w| w.starts_with(letter) && w[1..].contains('.'));
            word.and_then(|w| w.split('.').nth(1)).map(str::len)
        };
        assert_eq!((digits('X'), digits('A')), (Some(4), Some(5)));
        assert!(text.contains(" G56\n") && !text.contains("G54"));
        let other = text.replace(" G56\n", " G55\n");
        assert!(!report(&w, &other).passed());
    }
}

#[test]
fn the_extruder_is_driven_as_the_control_takes_it() {
    let text = |d| posted(WORLDS[1].1, d, Writing::default()).1;
    let linuxcnc = text("linuxcnc");
    assert!(linuxcnc.contains("\nM172\n") && !linuxcnc.contains("\nM72\n"));
    assert!(text("fanuc").starts_with("%\nO0001\n") && text("fanuc").ends_with("M30\n%\n"));
    assert!(text("fanuc").contains(" G4 P500\n"));
    let (w, rrf) = posted(WORLDS[1].1, "rrf", Writing::default());
    assert!(rrf.contains("M42 P0 S1\n") && rrf.contains("G1 E-1.50000") && rrf.ends_with("M0\n"));
    assert!(!rrf.contains("M30") && !rrf.contains("M72") && !rrf.contains('('));
    // Filament by E words is the beads' volume.
    let word = |l: &str| {
        let moves = l.contains('X') || l.contains('Y');
        l.split(" E").nth(1).filter(|_| moves)?.split(' ').next()?.parse::<f64>().ok()
    };
    let e: f64 = rrf.lines().filter_map(word).sum();
    let laid = paths(&w).all()[0].figures.material_mm3;
    let section = std::f64::consts::PI * 1.75f64.powi(2) / 4.0;
    assert!((e * section - laid).abs() < 1e-3 * laid, "{} {laid}", e * section);
}

#[test]
fn filament_that_is_changed_is_caught_on_its_line() {
    let (w, text) = posted(WORLDS[1].1, "rrf", Writing::default());
    let lines: Vec<&str> = text.lines().collect();
    let beads: Vec<usize> =
        (0..lines.len()).filter(|i| lines[*i].contains('X') && lines[*i].contains(" E")).collect();
    for at in [beads[3], beads[beads.len() / 2]] {
        let mut changed: Vec<String> = lines.iter().map(|l| (*l).to_string()).collect();
        changed[at] = changed[at].replace(" E", " E1");
        let r = report(&w, &(changed.join("\n") + "\n"));
        assert!(r.findings.iter().any(|f| f.line == at + 1 && f.rule == Rule::Extruder));
    }
}

/// A round tower printed on a block, its wall that of a mesh of many sides.
fn round_tower(machine: &str) -> World {
    let block = |p: DVec3| p.x > 2.0 && p.x < 22.0 && p.y > 2.0 && p.y < 18.0 && p.z < 4.0;
    let round = |p: DVec3| (p.x - 12.0).hypot(p.y - 10.0) < 6.0 && p.z < 7.0;
    let size = DVec3::new(24.0, 20.0, 10.0);
    let mut w = world(machine, 0.5, size, block, &[(StepKind::Additive, DVec3::Z, round)]);
    const SIDES: u32 = 240;
    let ring = |z: f64| {
        (0..SIDES).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(SIDES)).sin_cos();
            DVec3::new(12.0 + 6.0 * cos, 10.0 + 6.0 * sin, z)
        })
    };
    let middles = [0.0, 7.0].map(|z| DVec3::new(12.0, 10.0, z));
    let vertices = ring(0.0).chain(ring(7.0)).chain(middles).collect();
    let side = |i: u32| {
        let (a, b) = (i, (i + 1) % SIDES);
        let (low, high) = (2 * SIDES, 2 * SIDES + 1);
        [[a, b, b + SIDES], [a, b + SIDES, a + SIDES], [low, b, a], [high, a + SIDES, b + SIDES]]
    };
    w.job.target_mesh = TriMesh::new(vertices, (0..SIDES).flat_map(side).collect()).unwrap();
    w
}

#[test]
fn arcs_are_written_where_asked_for_and_read_back() {
    for dialect in ["linuxcnc", "rrf"] {
        let plain = posted(round_tower, dialect, Writing::default());
        let (w, text) = posted(round_tower, dialect, Writing { arcs: true, ..Writing::default() });
        let arcs = |t: &str| t.lines().filter(|l| l.contains(" I") && l.contains(" J")).count();
        assert!(arcs(&plain.1) == 0 && arcs(&text) > 50, "{dialect}: {}", arcs(&text));
        assert!(2 * text.lines().count() < plain.1.lines().count());
        let ctx = crate::base::Ctx::quiet();
        let r = check(&text, &w.job, &w.plan, Some(&paths(&w)), &ctx).unwrap();
        assert!(r.passed(), "{dialect}:\n{}", told(&r));
        // An arc whose centre is off, one that turns the other way, one that climbs.
        let lines: Vec<&str> = text.lines().collect();
        let all: Vec<usize> = (0..lines.len()).filter(|i| lines[*i].contains(" I")).collect();
        let at = all[all.len() / 2];
        let turned = if lines[at].contains("G3") { "G2" } else { "G3" };
        let now = lines[at].replace(if turned == "G2" { "G3" } else { "G2" }, turned);
        for bad in [lines[at].replace(" I", " I1"), now, format!("{} Z1", lines[at])] {
            let mut changed: Vec<String> = lines.iter().map(|l| (*l).to_string()).collect();
            changed[at] = bad.clone();
            let r = report(&w, &(changed.join("\n") + "\n"));
            assert!(r.findings.iter().any(|f| f.line == at + 1), "{bad}:\n{}", told(&r));
        }
        // A control that takes no arcs reads none.
        let mut other = round_tower("generic-5axis");
        other.job.machine.control.dialect = dialect.into();
        assert!(!report(&other, &text).passed());
    }
}

#[test]
fn each_step_is_a_program_of_its_own() {
    for dialect in DIALECTS {
        let mut w = WORLDS[2].1("generic-5axis");
        w.job.machine.control.dialect = dialect.into();
        let program = post(&w.job, &w.plan, &paths(&w), "sha256:0").unwrap();
        let steps = program.steps();
        assert_eq!(steps.len(), 2);
        // What both begin and end with is the whole program's.
        let shared = |f: fn(&str) -> Vec<&str>| {
            let (a, b, all) = (f(&steps[0]), f(&steps[1]), f(program.text()));
            let same = |x: &[&str]| x.iter().zip(&all).take_while(|(p, q)| p == q).count();
            same(&a).min(same(&b))
        };
        let head = shared(|t| t.lines().collect());
        let tail = shared(|t| t.lines().rev().collect());
        assert!(head > 10 && tail >= 2, "{dialect}: {head} {tail}");
        let changes = |t: &str| {
            let code = |l: &&str| l.contains(" M6") || (dialect == "rrf" && l.starts_with('T'));
            t.lines().filter(code).count()
        };
        assert!(steps.iter().all(|s| changes(s) == 1), "{dialect}");
        let inner = |t: &str| t.lines().count() - head - tail;
        assert_eq!(inner(&steps[0]) + inner(&steps[1]), inner(program.text()), "{dialect}");
        // The first by itself is the program of a plan that ends there.
        w.plan.steps.truncate(1);
        let r = report(&w, &steps[0]);
        assert!(r.passed(), "{dialect}:\n{}", told(&r));
    }
}

// A strict reading of RS274NGC as LinuxCNC documents it, written from its manual's tables.

/// Modal groups of G codes in tenths; 0 for the non-modal ones.
fn g_group(tenths: u32) -> Option<u32> {
    Some(match tenths {
        40 | 100 | 280 | 281 | 300 | 301 | 520 | 530 | 920 | 921 | 922 | 923 => 0,
        0 | 10 | 20 | 30 | 330 | 382..=385 | 730 | 760 | 800..=890 => 1,
        170 | 180 | 190 | 171 | 181 | 191 => 2,
        900 | 910 => 3,
        901 | 911 => 4,
        930 | 940 | 950 => 5,
        200 | 210 => 6,
        400 | 410 | 411 | 420 | 421 => 7,
        430 | 431 | 432 | 490 => 8,
        980 | 990 => 10,
        540..=593 => 12,
        610 | 611 | 640 => 13,
        960 | 970 => 14,
        70 | 80 => 15,
        _ => return None,
    })
}

/// Modal groups of M codes; user-defined ones are a group of their own.
fn m_group(code: u32) -> Option<u32> {
    Some(match code {
        0 | 1 | 2 | 30 | 60 => 4,
        6 | 61 => 6,
        3 | 4 | 5 | 19 => 7,
        7..=9 => 8,
        48..=53 => 9,
        62..=68 => 5,
        70..=73 => 11,
        100..=199 => 10,
        _ => return None,
    })
}

/// Reads a program as strictly as the standard allows; the first fault with its line.
fn strictly(text: &str) -> Result<(), String> {
    let (mut feed, mut motion, mut speed, mut tool) = (None, None::<u32>, None, None);
    let (mut spindle, mut ended) = (false, false);
    for (i, line) in text.lines().enumerate() {
        let fail = |what: &str| Err(format!("line {}: {what}: {line}", i + 1));
        if line.len() > 255 || !line.is_ascii() {
            return fail("too long or not ASCII");
        }
        let mut code = String::new();
        let mut depth = 0;
        for c in line.chars() {
            match c {
                '(' if depth == 0 => depth = 1,
                ')' if depth == 1 => depth = 0,
                '(' | ')' => return fail("nested comment"),
                c if depth == 0 => code.push(c),
                _ => {}
            }
        }
        if depth != 0 {
            return fail("comment is not closed");
        }
        let words: Vec<&str> = code.split_whitespace().collect();
        if words.is_empty() {
            continue;
        }
        if ended {
            return fail("after the end");
        }
        let (mut letters, mut groups) = (Vec::new(), Vec::new());
        let (mut gs, mut ms) = (Vec::new(), Vec::new());
        for (k, w) in words.iter().enumerate() {
            let letter = w.chars().next().unwrap();
            let Ok(value) = w[1..].parse::<f64>() else { return fail("no number") };
            match letter {
                'G' => {
                    let tenths = (value * 10.0).round() as u32;
                    let Some(group) = g_group(tenths) else { return fail("unknown G code") };
                    if group != 0 && groups.contains(&('G', group)) {
                        return fail("two G codes of one group");
                    }
                    groups.push(('G', group));
                    gs.push(tenths);
                }
                'M' => {
                    let Some(group) = m_group(value as u32) else { return fail("unknown M code") };
                    if groups.contains(&('M', group)) {
                        return fail("two M codes of one group");
                    }
                    groups.push(('M', group));
                    ms.push(value as u32);
                }
                'N' if k > 0 => return fail("a line number that is not first"),
                'N' | 'X' | 'Y' | 'Z' | 'A' | 'C' | 'F' | 'S' | 'T' | 'P' | 'H' => {
                    if letters.contains(&letter) {
                        return fail("a word twice");
                    }
                    letters.push(letter);
                    match letter {
                        'F' if value <= 0.0 => return fail("no feed"),
                        'F' => feed = Some(value),
                        'S' => speed = Some(value),
                        'T' => tool = Some(value),
                        _ => {}
                    }
                }
                _ => return fail("unknown word"),
            }
        }
        let has = |l: char| letters.contains(&l);
        let axes = "XYZAC".chars().any(has);
        if let Some(g) = gs.iter().find(|g| g_group(**g) == Some(1)) {
            motion = Some(*g);
        }
        if gs.contains(&530) && !(axes && matches!(motion, Some(0 | 10))) {
            return fail("G53 without straight motion");
        }
        if axes {
            match motion {
                Some(0) => {}
                Some(10) if feed.is_none() => return fail("cutting without a feed"),
                Some(10) => {}
                _ => return fail("axis words without motion"),
            }
        }
        if has('P') && !gs.iter().any(|g| matches!(g, 40 | 640)) {
            return fail("P without a code that takes it");
        }
        if has('H') && !gs.contains(&430) {
            return fail("H without G43");
        }
        if gs.contains(&40) && (axes || !has('P')) {
            return fail("a dwell with motion, or without P");
        }
        for m in ms {
            match m {
                3 if speed.is_none_or(|s| s <= 0.0) => return fail("M3 without a speed"),
                3 => spindle = true,
                5 => spindle = false,
                6 if tool.is_none() => return fail("M6 without a tool"),
                6 if spindle => return fail("M6 while the spindle turns"),
                2 | 30 => ended = true,
                _ => {}
            }
        }
    }
    if ended { Ok(()) } else { Err("no end".into()) }
}

/// Numbered steps are written one after the other, others side by side.
#[test]
fn numbers_are_all_that_numbering_changes() {
    for (name, make) in WORLDS {
        let write = |line_numbers| {
            posted(make, "linuxcnc", Writing { line_numbers, ..Writing::default() }).1
        };
        let (plain, numbered) = (write(None), write(Some(true)));
        assert!(numbered.contains("\nN"), "{name}");
        let bared: Vec<&str> = numbered
            .lines()
            .map(|l| l.strip_prefix('N').and_then(|l| l.split_once(' ')).map_or(l, |(_, l)| l))
            .collect();
        assert_eq!(bared, plain.lines().collect::<Vec<_>>(), "{name}");
    }
}

#[test]
fn linuxcnc_programs_pass_a_strict_reading() {
    for (name, make) in WORLDS {
        for numbered in [None, Some(true)] {
            let ask = Writing { line_numbers: numbered, ..Writing::default() };
            let (_, text) = posted(make, "linuxcnc", ask);
            strictly(&text).unwrap_or_else(|e| panic!("{name}: {e}"));
        }
    }
    let (_, text) = posted(WORLDS[0].1, "linuxcnc", Writing::default());
    let feed = text.lines().find(|l| l.contains(" F")).unwrap();
    let bare = feed.split(" F").next().unwrap();
    for (old, new) in [
        (feed, bare),
        ("G21\n", "G21 G20\n"),
        ("M3 S", "M3 Q"),
        ("M30\n", ""),
        ("T1 M6\n", "M6\n"),
        ("G17\n", "G17 X1\n"),
        ("G94\n", "G94 P1\n"),
        ("M5\n", "M72 M5 M9 M73\n"),
    ] {
        assert!(text.contains(old), "{old}");
        assert!(strictly(&text.replacen(old, new, 1)).is_err(), "{old} → {new}");
    }
}
