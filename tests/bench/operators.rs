//! Speed of the operators, on grids of the published sizes and on real parts, beside the FFT engine
//! and the Python libraries of `requirements.txt`.
//!
//! `cargo bench` measures; the table of `docs/performance.md` is what it printed. Every figure is
//! wall time and CPU time of the same runs. The Python libraries run in an environment of their
//! own under `target/`, on the same voxels; without Python their lines are left out, saying so.

mod peers;
mod scene;

use criterion::{Criterion, criterion_group, criterion_main};
use hmplan::access::{self, Engine, Scene, VoxelTool, over_cut, reached_along};
use hmplan::base::{DVec3, Direction};
use hmplan::machine::Tool;
use hmplan::morph::{self, Axis, ENDLESS_UP, Element, Layer, Window};
use hmplan::voxel::{Connectivity, components};
use scene::{Part, measure, report};

/// The cylinder of the published trial: radius 9, height 60 voxels.
fn cylinder() -> Element {
    Element::from_layers(vec![Layer { z: 0, end: 60, plane: Element::disk(9.0) }])
}

fn preset(name: &str) -> Tool {
    Tool::builtin(name).expect("a preset")
}

/// A direction on no axis of the grid.
fn tilted() -> Direction {
    Direction::new(DVec3::new(0.31, -0.42, 0.85)).expect("a direction")
}

fn operators(part: &Part) {
    let name = &part.name;
    let scene = Scene::new(&part.frame, &part.solid, &[]);
    for tool in ["w2v-cutter", "vasco-cutter", "w2v-nozzle"] {
        let tool = preset(tool);
        let label = format!("{name}: accessible region, {}, any direction, depth", tool.name);
        measure(&label, 5, || reached_along(&scene, &part.solid, &tool, tilted()));
        let label = format!("{name}: accessible region, {}, +z, depth", tool.name);
        measure(&label, 5, || reached_along(&scene, &part.solid, &tool, Direction::Z));
    }
    measure(&format!("{name}: obstacle points of a state"), 5, || {
        Scene::new(&part.frame, &part.solid, &[])
    });
    let window = Window::of(part.frame.dims);
    let bits = measure(&format!("{name}: cylinder r 9 × 60, bits"), 9, || {
        morph::dilate(morph::Engine::Bits, &part.solid, &cylinder(), &window)
    });
    if part.is_small() {
        let fft = measure(&format!("{name}: cylinder r 9 × 60, FFT"), 1, || {
            morph::dilate(morph::Engine::Fft, &part.solid, &cylinder(), &window)
        });
        report(&format!("{name}: bits over FFT"), fft.wall / bits.wall);
    }
    let tool = preset("vasco-cutter");
    let voxels = VoxelTool::along(&tool, Direction::Z, part.frame.pitch).expect("an axis");
    let best = access::choose(part.frame.dims, &voxels).engine;
    let ours = measure(&format!("{name}: vasco-cutter on voxels, {best:?}"), 5, || {
        access::accessible(best, &part.solid, &voxels)
    });
    measure(&format!("{name}: vasco-cutter on voxels, Bits"), 3, || {
        access::accessible(Engine::Bits, &part.solid, &voxels)
    });
    if part.is_small() {
        let fft = measure(&format!("{name}: vasco-cutter on voxels, FFT"), 1, || {
            access::accessible(Engine::Fft, &part.solid, &voxels)
        });
        report(&format!("{name}: {best:?} over FFT, vasco-cutter"), fft.wall / ours.wall);
    }
    measure(&format!("{name}: components, 26 neighbours"), 5, || {
        components(&part.solid, Connectivity::Corner26)
    });
    measure(&format!("{name}: distance transform"), 2, || {
        hmplan::voxel::distance_squared(&part.solid)
    });
    let up = Axis::of(Direction::Z).expect("an axis");
    for (angle, of) in [(0.0, "columns"), (45.0, "45°")] {
        let overhang = access::Overhang::degrees(angle).expect("an angle");
        measure(&format!("{name}: self-supported, {of}"), 3, || {
            access::self_supported(&part.solid, up, 0, overhang)
        });
        measure(&format!("{name}: supporting, {of}"), 3, || {
            access::supporting(&part.solid, up, 0, overhang)
        });
    }
}

/// Six directions in turn, each cutting what it can, until none cuts more.
fn joint_over_cut(part: &Part) {
    use Direction as D;
    let tool = preset("w2v-cutter");
    let scene = Scene::new(&part.frame, &part.solid, &[]);
    let one = measure(&format!("{}: one accessible region, +z", part.name), 5, || {
        reached_along(&scene, &part.solid, &tool, D::Z)
    });
    let stock = part.stock();
    let joint = measure(&format!("{}: joint over-cut, six directions", part.name), 1, || {
        let mut state = stock.clone();
        loop {
            let before = state.count();
            for d in [D::Z, D::X, D::NEG_X, D::Y, D::NEG_Y, D::NEG_Z] {
                let removable = state.minus(&part.solid);
                let cut = over_cut(&part.frame, &state, &removable, &[], &tool, d);
                state.subtract(&cut.region);
            }
            if state.count() == before {
                return state;
            }
        }
    });
    report(&format!("{}: joint over-cut over one region", part.name), joint.wall / one.wall);
}

fn threads(part: &Part) {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads");
    let tool = preset("w2v-cutter");
    let scene = Scene::new(&part.frame, &part.solid, &[]);
    let directions = hmplan::base::fibonacci_sphere(8);
    let [one, two] = [1, 2].map(|n| {
        pool(n).install(|| {
            measure(&format!("{}: eight directions, {n} threads", part.name), 2, || {
                let of = |d: &Direction| reached_along(&scene, &part.solid, &tool, *d).count();
                use rayon::prelude::*;
                directions.par_iter().map(of).collect::<Vec<_>>()
            })
        })
    });
    report(&format!("{}: two threads over one", part.name), one.wall / two.wall);
}

fn benches(_: &mut Criterion) {
    println!("load before: {}", scene::load());
    let small = Part::synthetic("251×315×243", [251, 315, 243]);
    operators(&small);
    joint_over_cut(&small);
    threads(&small);
    match peers::run(&small) {
        Ok(text) => print!("{text}"),
        Err(why) => println!("Python libraries left out: {why}"),
    }
    operators(&Part::synthetic("512³", [512; 3]));
    for part in Part::real() {
        operators(&part);
    }
    println!("load after: {}", scene::load());
}

/// Small kernels, by criterion.
fn kernels(c: &mut Criterion) {
    let part = Part::synthetic("251×315×243", [251, 315, 243]);
    let window = Window::of(part.frame.dims);
    let platform = Element::from_layers(vec![
        Layer { z: 0, end: 26, plane: Element::disk(3.0) },
        Layer { z: 26, end: 86, plane: Element::disk(50.0) },
        Layer { z: 86, end: ENDLESS_UP, plane: morph::Plane::Whole },
    ])
    .reflected();
    let mut group = c.benchmark_group("kernels");
    group.sample_size(10);
    group.bench_function("cylinder r 9 × 60, bits", |b| {
        b.iter(|| morph::dilate(morph::Engine::Bits, &part.solid, &cylinder(), &window))
    });
    group.bench_function("three segments and platform, bits", |b| {
        b.iter(|| morph::dilate(morph::Engine::Bits, &part.solid, &platform, &window))
    });
    group.bench_function("components", |b| {
        b.iter(|| components(&part.solid, Connectivity::Edge18).count())
    });
    group.finish();
}

criterion_group!(all, benches, kernels);
criterion_main!(all);
