//! Parts to measure on, and the clocks.

use hmplan::base::{Ctx, DVec3};
use hmplan::mesh;
use hmplan::voxel::{BitGrid, Frame, voxelise};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

pub struct Part {
    pub name: String,
    pub frame: Frame,
    pub solid: BitGrid,
}

/// A third of the smallest tip radius of the presets.
const PITCH_MM: f64 = 0.5;

impl Part {
    /// A bracket of curved plates, pockets and holes with about a quarter of its box solid, as the
    /// published bracket of this size.
    pub fn synthetic(name: &str, dims: [usize; 3]) -> Part {
        let frame = Frame { pitch: PITCH_MM, dims, origin: DVec3::ZERO };
        let solid = BitGrid::from_fn(dims, |v| {
            let [x, y, z]: [f64; 3] = std::array::from_fn(|a| v[a] as f64 / dims[a] as f64);
            let edge = [x, y, z].iter().any(|c| !(0.02..0.98).contains(c));
            let base = z < 0.16;
            let ribs = ((6.0 * x).sin() * (7.0 * y).cos() + (5.0 * z).sin() - 0.6).abs() < 0.32;
            let hole = (x - 0.5).hypot(y - 0.5) < 0.13 || (y - 0.3).hypot(z - 0.55) < 0.09;
            !edge && (base || ribs) && !hole
        });
        Part { name: name.into(), frame, solid }
    }

    /// Meshes beside the project, where there are any.
    pub fn real() -> Vec<Part> {
        ["ge_bracket.stl", "fandisk.off", "simjeb_101.obj"]
            .iter()
            .filter_map(|name| {
                let path =
                    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/meshes").join(name);
                let options = mesh::ReadOptions { mm_per_unit: 1.0 };
                let Ok(loaded) = mesh::read(&path, &options) else {
                    println!("{name} left out: it is not there");
                    return None;
                };
                let size = loaded.mesh.bounds().size();
                let pitch = (size.x * size.y * size.z / 8e6).cbrt().min(PITCH_MM);
                let frame = Frame::around(loaded.mesh.bounds(), pitch, 1).ok()?;
                let solid = voxelise(&loaded.mesh, &frame, &Ctx::quiet()).ok()?;
                Some(Part { name: (*name).into(), frame, solid })
            })
            .collect()
    }

    /// Whether the transform of a whole grid takes seconds, not minutes.
    pub fn is_small(&self) -> bool {
        self.frame.voxel_count() < 30_000_000
    }

    /// The block that the part is cut from.
    pub fn stock(&self) -> BitGrid {
        let n = self.frame.dims;
        BitGrid::from_fn(n, |v| (0..3).all(|a| v[a] > n[a] / 50 && v[a] < n[a] - 1 - n[a] / 50))
    }
}

/// Best wall time and its CPU time, milliseconds.
#[derive(Clone, Copy)]
pub struct Times {
    pub wall: f64,
    pub cpu: f64,
}

/// Runs `work` a few times after a first one that is not counted, and prints the best.
pub fn measure<R>(label: &str, runs: usize, mut work: impl FnMut() -> R) -> Times {
    if runs > 1 {
        black_box(work());
    }
    let mut best = Times { wall: f64::INFINITY, cpu: f64::INFINITY };
    for _ in 0..runs {
        let (began, cpu) = (Instant::now(), cpu_ms());
        black_box(work());
        best.wall = best.wall.min(began.elapsed().as_secs_f64() * 1e3);
        best.cpu = best.cpu.min(cpu_ms() - cpu);
    }
    println!("{label:<70} {:9.2} ms wall {:9.2} ms CPU", best.wall, best.cpu);
    best
}

pub fn report(label: &str, ratio: f64) {
    println!("{label:<70} {ratio:9.1} ×");
}

/// CPU time of this process so far, milliseconds; of all its threads.
fn cpu_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

/// The load averages, as the system says them.
pub fn load() -> String {
    std::fs::read_to_string("/proc/loadavg").unwrap_or_else(|_| "unknown".into()).trim().into()
}
