use super::*;
use crate::machine::{BaseKind, HoldingMode, Table, Workholding};

fn cutter() -> Tool {
    Tool::builtin("w2v-cutter").expect("a preset")
}

fn input(path: &str) -> Input {
    Input {
        path: path.into(),
        sha256: "00".into(),
        triangles: 12,
        watertight: true,
        volume_mm3: 1.0,
        mm_per_unit: 1.0,
        transform: Input::rows_of(&DAffine3::IDENTITY),
        warnings: Vec::new(),
    }
}

fn example() -> PlanFile {
    let grid = Frame { pitch: 0.7, dims: [70, 3, 2], origin: DVec3::new(-0.1, 0.0, 1e-3) };
    let step = |from: usize| Step {
        kind: StepKind::Subtractive,
        tool: "w2v-cutter".into(),
        direction: Direction::new(DVec3::new(0.1, -0.7, 0.3)).unwrap(),
        holding: 0,
        region: BitGrid::from_fn(grid.dims, |v| v[0] >= from && v[1] != 1),
        block: 0,
        origin: Origin::default(),
    };
    let plan = Plan { holdings: vec![Holding::AS_CLAMPED], steps: vec![step(65), step(3)] };
    PlanFile {
        schema: SCHEMA.into(),
        hmplan_version: "0.0.0".into(),
        seed: 7,
        command: Command {
            planner: "reman".into(),
            setup: "keep".into(),
            resolution_mm: None,
            iterations: 500,
            time_limit_s: None,
            search: None,
            post_unverified: false,
            finish_mm: 0.0,
        },
        inputs: Inputs { initial: Some(input("a.stl")), target: input("b.stl") },
        grid,
        machine: Machine::builtin("generic-5axis").expect("the default machine"),
        tools: vec![cutter()],
        rules: Rules {
            holding: HoldingMode::Base,
            base: BaseKind::Pedestal,
            ..Rules::for_pitch(0.7, 0.2)
        },
        holdings: plan.holdings.clone(),
        steps: PlanFile::step_records(&plan, &grid, &[1.5]),
        program: None,
        summary: Summary { planner: "reman".into(), ..Summary::default() },
    }
}

#[test]
fn a_file_reads_back_to_itself() {
    let file = example();
    let bytes = file.to_json();
    let again = PlanFile::from_json(&bytes).unwrap();
    assert_eq!(again, file);
    assert_eq!(again.to_json(), bytes);
    assert_eq!(again.plan().unwrap().steps[1].region.count(), 67 * 2 * 2);
}

#[test]
fn a_region_takes_one_line() {
    let text = String::from_utf8(example().to_json()).unwrap();
    assert_eq!(text.lines().filter(|l| l.contains("\"region\": {")).count(), 2);
    assert!(text.lines().all(|l| !l.contains("\"region\"") || l.contains("sha256")));
}

/// Every single digit of every region, changed: each file is refused, none panics.
#[test]
fn no_digit_of_a_region_can_be_changed() {
    let bytes = example().to_json();
    let text = String::from_utf8(bytes.clone()).unwrap();
    let mut at = 0;
    let mut tried = 0;
    for line in text.split_inclusive('\n') {
        if line.contains("\"region\"") {
            for (i, c) in line.bytes().enumerate().filter(|(_, c)| c.is_ascii_digit()) {
                let mut changed = bytes.clone();
                changed[at + i] = if c == b'9' { b'1' } else { c + 1 };
                // "sha256" itself holds digits: then the field has another name.
                let refused = match PlanFile::from_json(&changed) {
                    Err(_) => true,
                    Ok(file) => match file.plan() {
                        Err(e) => e.is_alteration() && e.to_string().starts_with("step "),
                        Ok(_) => false,
                    },
                };
                assert!(refused, "byte {i} of {line}");
                tried += 1;
            }
        }
        at += line.len();
    }
    assert!(tried > 100, "{tried}");
}

#[test]
fn timings_do_not_reach_the_canonical_form() {
    let mut slow = example();
    let fast = slow.canonical_without_timings();
    assert!(slow.summary.seconds.add("search", 12.0));
    assert!(!slow.summary.seconds.add("lunch", 1.0));
    slow.summary.peak_memory_mib = Some(99.0);
    assert_eq!(slow.canonical_without_timings(), fast);
    slow.summary.reused_mm3 = 1.0;
    assert_ne!(slow.canonical_without_timings(), fast);
}

/// What a file may not say, and a word of the message that says so.
#[test]
fn hostile_figures_are_refused_by_name() {
    type Change = fn(&mut PlanFile);
    let cases: [(&str, Change); 16] = [
        ("schema", |f| f.schema = "hmplan-plan/9".into()),
        ("grid", |f| f.grid.dims = [usize::MAX, usize::MAX, 2]),
        ("grid", |f| f.grid.dims = [0, 1, 1]),
        ("grid", |f| f.grid.dims = [1 << 20, 1 << 10, 4]),
        ("bits", |f| {
            // Two voxels, but all rows lie between them.
            let ends = BitGrid::from_fn([200; 3], |v| v == [0; 3] || v == [199; 3]);
            f.steps[0].region = RunRows::from_grid(&ends);
            f.steps = vec![f.steps[0].clone(); 5_000];
        }),
        ("pitch", |f| f.grid.pitch = -1.0),
        ("index", |f| f.steps[1].index = 1),
        ("holding", |f| f.steps[1].holding = 1),
        ("tool", |f| f.steps[0].tool = "drill".into()),
        ("tool", |f| f.steps[0].kind = StepKind::Additive),
        ("transform", |f| f.inputs.target.transform[0] = 2.0),
        ("mm_per_unit", |f| f.inputs.initial.as_mut().unwrap().mm_per_unit = 0.0),
        ("tolerance_mm", |f| f.rules.tolerance_mm = -1.0),
        ("tolerance_mm", |f| f.rules.tolerance_mm = 1e300),
        ("overhang_deg", |f| f.rules.overhang_deg = 1e300),
        ("deviation", |f| f.rules.deviation = 1.5),
    ];
    for (word, change) in cases {
        let mut file = example();
        if word == "bits" {
            file.grid.dims = [200, 200, 200];
        }
        change(&mut file);
        let e = PlanFile::from_json(&file.to_json()).unwrap_err();
        assert!(e.to_string().contains(word), "{word}: {e}");
        assert!(!e.is_alteration(), "{word}");
    }
}

#[test]
fn what_is_no_plan_file_is_said_with_its_place() {
    for bytes in [&b""[..], b"{", b"[1,2]", b"{\"schema\": \"hmplan-plan/1\"}", &[0xff, 0x00]] {
        assert!(matches!(PlanFile::from_json(bytes), Err(FileError::Json { .. })));
    }
    let deep = "[".repeat(100_000);
    assert!(PlanFile::from_json(deep.as_bytes()).is_err());
}

#[test]
fn a_transform_survives_its_sixteen_figures() {
    let turn = DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(-1.1);
    let motion = DAffine3::from_mat3_translation(turn, DVec3::new(1.0, -2.0, 0.3));
    let record = Input { transform: Input::rows_of(&motion), ..input("a") };
    assert_eq!(record.plan_from_part(), Some(motion));
    assert_eq!(record.transform[3], 1.0, "shift in the last column of each row");
}

/// The schema printed by `hmplan schema plan` is the one the file obeys.
#[test]
fn the_file_obeys_its_schema() {
    let schema = serde_json::to_value(schemars::schema_for!(PlanFile)).unwrap();
    let validator = jsonschema::validator_for(&schema).unwrap();
    let mut value: serde_json::Value = serde_json::from_slice(&example().to_json()).unwrap();
    if let Some(e) = validator.iter_errors(&value).next() {
        panic!("{e} at {}", e.instance_path());
    }
    value["steps"][0]["kind"] = "sideways".into();
    assert!(!validator.is_valid(&value));
}

#[test]
fn unused_kinds_of_table_still_serialise() {
    let mut file = example();
    file.machine.workholding =
        Workholding { table: Table::Box { x_mm: 5.0, y_mm: 6.0 }, ..file.machine.workholding };
    assert_eq!(PlanFile::from_json(&file.to_json()).unwrap(), file);
}
