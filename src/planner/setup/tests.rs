use super::*;
use crate::base::{Ctx, DVec3};
use proptest::prelude::*;

/// Two blocks, one on the other: no symmetry but its own.
fn stepped() -> TriMesh {
    TriMesh::joined(&[
        TriMesh::cuboid(DVec3::ZERO, DVec3::new(60.0, 30.0, 12.0)),
        TriMesh::cuboid(DVec3::new(4.0, 3.0, 12.0), DVec3::new(24.0, 15.0, 40.0)),
    ])
}

fn moved(mesh: &TriMesh, rotation: DMat3, shift: DVec3) -> TriMesh {
    mesh.transformed(&DAffine3::from_mat3_translation(rotation, shift)).unwrap()
}

/// With fewer rotations than the default, which only cost time where a face to rest on is right.
fn found(initial: &TriMesh, target: &TriMesh) -> SetupReport {
    let options = SetupOptions { rotations: 30, carried: 3, ..SetupOptions::default() };
    search(initial, target, &options, &Ctx::quiet()).unwrap()
}

#[test]
fn the_same_part_twice_stays_where_it_is() {
    let part = stepped();
    let report = found(&part, &part);
    assert_eq!(report.winner.transform, DAffine3::IDENTITY);
    assert_eq!(report.winner.reused_share, 1.0);
    // All of it reused and nothing to print: both terms of the bases are whole.
    assert!((report.winner.score_fine - (0.4 + 0.6 * 2.0)).abs() < 1e-12);
    assert_eq!(report.best[0], report.winner, "nothing is left to refine");
    assert!(
        report
            .note(&report.winner)
            .contains("as in its file, shift (0.00, 0.00, 0.00) mm, 100.0 %")
    );
}

/// A pose that the search has left is still a candidate, unmoved.
#[test]
fn the_pose_of_the_files_is_among_the_others() {
    let part = stepped();
    let target = moved(&part, DMat3::IDENTITY, DVec3::new(5.0, 0.0, 0.0));
    let options = SetupOptions { rotations: 10, carried: 2, refined: 3, ..SetupOptions::default() };
    let report = search(&part, &target, &options, &Ctx::quiet()).unwrap();
    assert!(report.winner.reused_share > 0.99, "{report:?}");
    assert_eq!(report.others[0].transform, DAffine3::IDENTITY, "{report:?}");
    assert!(report.others[0].reused_share < 0.95, "{report:?}");
    let again = search(&part, &part, &options, &Ctx::quiet()).unwrap();
    assert!(again.others.iter().all(|o| !o.is_same(&again.winner)), "{again:?}");
}

/// Moved by what a file rounds off, a real bracket lay otherwise on the grid, and its plan left a voxel.
#[test]
fn what_a_file_rounds_off_moves_nothing() {
    let part = stepped();
    let target = moved(&part, DMat3::IDENTITY, DVec3::new(0.0, 0.0, -8e-6));
    assert_eq!(found(&part, &target).winner.transform, DAffine3::IDENTITY);
    let sunk = moved(&part, DMat3::IDENTITY, DVec3::new(0.0, 0.0, -8e-2));
    let back = found(&part, &sunk).winner.transform.translation;
    assert!((back - DVec3::new(0.0, 0.0, 8e-2)).length() < 1e-9, "{back}");
}

#[test]
fn a_quarter_turn_and_a_shift_are_undone_exactly() {
    let part = stepped();
    let away = DVec3::new(137.0, -41.0, 9.0);
    let target = moved(&part, rotations::about_z(std::f64::consts::FRAC_PI_2), away);
    let report = found(&part, &target);
    assert!(report.winner.reused_share > 0.99, "{report:?}");
    let back = target.transformed(&report.winner.transform).unwrap();
    for (a, b) in back.vertices().iter().zip(part.vertices()) {
        assert!((*a - *b).length() < 1e-6, "{a} {b}");
    }
}

#[test]
fn a_part_laid_on_its_side_is_stood_up_again() {
    let part = stepped();
    let target = moved(&part, DMat3::from_rotation_x(std::f64::consts::FRAC_PI_2), DVec3::ONE);
    let report = found(&part, &target);
    assert!(report.winner.reused_share > 0.95, "{report:?}");
}

#[test]
fn a_heading_between_the_steps_is_refined() {
    let part = stepped();
    let target = moved(&part, rotations::about_z(1.0), DVec3::new(-20.0, 5.0, 0.0));
    let report = found(&part, &target);
    assert!(report.winner.reused_share > 0.97, "{report:?}");
}

#[test]
fn a_bracket_lies_in_its_block_although_their_feet_differ() {
    let block = TriMesh::cuboid(DVec3::ZERO, DVec3::new(60.0, 30.0, 40.0));
    let target = moved(&stepped(), rotations::about_z(2.1), DVec3::new(300.0, 200.0, -7.0));
    let report = found(&block, &target);
    assert!(report.winner.reused_share > 0.97, "{report:?}");
    assert_eq!(report.best.len(), 1 + 3 + 3, "file, faces, spread");
}

#[test]
fn the_base_decides_between_equal_volumes() {
    let at = |lowest_mm: Option<f64>, base_share: f64| {
        score_fine(&Measured { share: 0.5, top_mm: 20.0, lowest_mm, base_share }, Score::Both)
    };
    assert!((at(Some(20.0), 1.0 / 6.0) - (0.2 + 0.6 * (1.0 + 25.0 / 36.0))).abs() < 1e-12);
    assert!((at(Some(5.0), 0.5) - (0.2 + 0.6 * (0.25 + 0.25))).abs() < 1e-12);
    assert!(at(Some(0.0), 0.5) < at(Some(5.0), 0.5) && at(None, 0.0) > at(Some(5.0), 0.0));
    let nothing = Measured { share: 0.0, top_mm: 0.0, lowest_mm: None, base_share: 0.0 };
    assert_eq!(score_fine(&nothing, Score::Both), 0.0, "no reuse is no good setup");
}

#[test]
fn one_thread_and_two_find_the_same() {
    let initial = TriMesh::cuboid(DVec3::ZERO, DVec3::new(50.0, 50.0, 30.0));
    let target = moved(&stepped(), DMat3::from_rotation_y(0.3), DVec3::ZERO);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = SetupOptions { rotations: 20, carried: 2, ..SetupOptions::default() };
        pool.install(|| search(&initial, &target, &options, &Ctx::quiet()).unwrap())
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn a_stopped_search_ends() {
    use crate::base::Silent;
    use std::sync::{Arc, atomic::AtomicBool};
    let ctx = Ctx::new(Arc::new(AtomicBool::new(true)), None, Arc::new(Silent), 0);
    let part = stepped();
    let result = search(&part, &part, &SetupOptions::default(), &ctx);
    assert_eq!(result.unwrap_err(), PlanError::Cancelled);
}

#[test]
fn parts_without_volume_or_surface_are_named() {
    let (part, none) = (stepped(), TriMesh::default());
    let which =
        |a: &TriMesh, b: &TriMesh| match search(a, b, &SetupOptions::default(), &Ctx::quiet()) {
            Err(PlanError::Unmeasurable { which, .. }) => which,
            other => panic!("{other:?}"),
        };
    assert_eq!((which(&none, &part), which(&part, &none)), ("initial", "target"));
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let sheet = TriMesh::new(corners, vec![[0, 1, 2]]).unwrap();
    assert_eq!(which(&part, &sheet), "target");
}

/// Whether refining lost nothing: Score₂, or of placements that reuse too little to compete, what
/// they reuse.
fn gains(report: &SetupReport) -> bool {
    let (refined, before) = (&report.winner, &report.best[0]);
    refined.score_fine >= before.score_fine || refined.reused_share > before.reused_share
}

#[test]
fn where_all_reuse_too_little_the_share_decides() {
    let [x, y, z] = [1.1283531290448796, -1.2730504013546038, -0.4547203095546811];
    let rotation =
        DMat3::from_rotation_x(x) * DMat3::from_rotation_y(y) * DMat3::from_rotation_z(z);
    let target = moved(
        &stepped(),
        rotation,
        DVec3::new(71.09658325254688, -174.41790904802357, 41.39732714181249),
    );
    let initial = TriMesh::cuboid(
        DVec3::ZERO,
        DVec3::new(10.491610269926534, 15.30777197235184, 15.672659433489914),
    );
    let options = SetupOptions { rotations: 10, carried: 1, refined: 3, ..SetupOptions::default() };
    let report = search(&initial, &target, &options, &Ctx::quiet()).unwrap();
    for c in report.best.iter().chain([&report.winner]).chain(&report.others) {
        let placed = target.transformed(&c.transform).unwrap();
        assert!(placed.bounds().min.z.abs() < 1e-6, "{c:?}");
        assert!((0.0..=1.0).contains(&c.reused_share) && (0.0..=1.6).contains(&c.score_fine));
    }
    assert!(report.others.len() <= 2 && !report.others.contains(&report.winner));
    assert!(gains(&report));
    let most = report.best.iter().map(|c| c.reused_share).fold(0.0, f64::max);
    assert!(report.winner.reused_share >= LEAST_SHARE * most);
}

proptest! {
    // Each case is a whole search.
    #![proptest_config(ProptestConfig::with_cases(3))]

    #[test]
    fn the_target_stands_on_the_base(
        turn in prop::array::uniform3(-3.0f64..3.0),
        shift in prop::array::uniform3(-200.0f64..200.0),
        size in prop::array::uniform3(5.0f64..50.0),
    ) {
        let rotation = DMat3::from_rotation_x(turn[0])
            * DMat3::from_rotation_y(turn[1])
            * DMat3::from_rotation_z(turn[2]);
        let target = moved(&stepped(), rotation, DVec3::from_array(shift));
        let initial = TriMesh::cuboid(DVec3::ZERO, DVec3::from_array(size));
        let options =
            SetupOptions { rotations: 10, carried: 1, refined: 3, ..SetupOptions::default() };
        let report = search(&initial, &target, &options, &Ctx::quiet()).unwrap();
        for c in report.best.iter().chain([&report.winner]).chain(&report.others) {
            let placed = target.transformed(&c.transform).unwrap();
            prop_assert!(placed.bounds().min.z.abs() < 1e-6, "{:?}", c);
            prop_assert!((0.0..=1.0).contains(&c.reused_share));
            prop_assert!((0.0..=1.6).contains(&c.score_fine));
        }
        prop_assert!(report.others.len() <= 2 && !report.others.contains(&report.winner));
        prop_assert!(gains(&report));
        let most = report.best.iter().map(|c| c.reused_share).fold(0.0, f64::max);
        prop_assert!(report.winner.reused_share >= LEAST_SHARE * most, "{:?}", report);
    }
}

/// A block on a stub. Standing on the stub, a block-like target is two thirds inside, on a corner in the stub; on the
/// block's own face all of it is.
#[test]
fn the_initial_part_is_laid_on_the_face_where_most_is_reused() {
    let stub = TriMesh::joined(&[
        TriMesh::cuboid(DVec3::new(18.0, 12.0, 0.0), DVec3::new(42.0, 28.0, 20.0)),
        TriMesh::cuboid(DVec3::new(0.0, 0.0, 20.0), DVec3::new(60.0, 40.0, 40.0)),
    ]);
    let target = TriMesh::cuboid(DVec3::ZERO, DVec3::new(56.0, 36.0, 18.0));
    let options = SetupOptions { rotations: 10, carried: 2, ..SetupOptions::default() };
    let kept = search(&stub, &target, &options, &Ctx::quiet()).unwrap();
    let posed = search_poses(&stub, &target, &options, &Ctx::quiet()).unwrap();
    assert!(kept.winner.reused_share < 0.7, "{kept:?}");
    assert!(posed.report.winner.reused_share > 0.99, "{posed:?}");
    assert!(posed.pose > 0 && posed.poses > 1 && posed.note().contains("another face"));
    let lain = stub.transformed(&posed.initial).unwrap();
    assert!(lain.bounds().min.z.abs() < 1e-9, "{:?}", lain.bounds());
    // The wide end is down.
    let top = lain.vertices().iter().filter(|v| v.z > lain.bounds().max.z - 1e-6);
    assert!(Aabb::of(top.copied()).size().truncate().element_product() < 24.0 * 16.0 + 1e-6);
    // From there on no other pose is better.
    let again = search_poses(&lain, &target, &options, &Ctx::quiet()).unwrap();
    assert_eq!((again.pose, again.initial), (0, DAffine3::IDENTITY));
}
