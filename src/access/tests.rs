//! What every engine of the accessible region must pass.

use super::collateral::upright;
use super::*;
use crate::base::{Ctx, Direction, rng};
use crate::machine::{Tool, ToolKind};
use crate::morph::{Axis, ENDLESS_UP, Element, Layer, Window, cardinal_rotations, turned};
use crate::voxel::{BitGrid, Frame, voxelise};
use rand::Rng as _;
use rayon::prelude::*;

const FAST: [Engine; 3] = [Engine::Depth, Engine::Bits, Engine::Fft];

fn small(n: usize, bits: u32) -> BitGrid {
    BitGrid::from_fn([n; 3], |[x, y, z]| bits >> (x + n * (y + n * z)) & 1 == 1)
}

/// The voxels of a cube of side `n` as a tool, its lowest slice active; with `endless` each column
/// goes up without end.
fn tool(n: usize, bits: u32, endless: bool) -> VoxelTool {
    let grid = small(n, bits);
    let mid = n as i64 / 2;
    let edge = BitGrid::from_fn([n; 3], |v| v[2] == 0 && grid.get(v));
    let edge = Element::from_grid(&edge, [mid, mid, 0]);
    if !endless {
        return VoxelTool::of_elements(Element::from_grid(&grid, [mid, mid, 0]), edge, None);
    }
    let mut layers = Vec::new();
    let mut below = BitGrid::new([n, n, 1]);
    for z in 0..n {
        let slice = BitGrid::from_fn([n, n, 1], |[x, y, _]| grid.get([x, y, z]));
        below.union_with(&slice);
        if let [layer] = Element::from_grid(&below, [mid, mid, 0]).layers() {
            let end = if z + 1 == n { ENDLESS_UP } else { z as i64 + 1 };
            layers.push(Layer { z: z as i64, end, plane: layer.plane.clone() });
        }
    }
    VoxelTool::of_elements(Element::from_layers(layers), edge, None)
}

fn agree(solid: &BitGrid, tool: &VoxelTool, engines: &[Engine]) {
    let expected = accessible(Engine::Naive, solid, tool);
    for e in engines.iter().filter(|e| **e != Engine::Depth || tool.never_narrows()) {
        assert_eq!(&accessible(*e, solid, tool), &expected, "{e:?} {solid:?} {tool:?}");
    }
}

/// The transform too goes through every pair, not only through some: minutes more.
fn all_pairs() -> bool {
    std::env::var_os("HMPLAN_ALL_PAIRS").is_some()
}

#[test]
fn every_small_solid_with_every_small_tool() {
    let all = all_pairs();
    (0..256u32).into_par_iter().for_each(|s| {
        for t in 1..256 {
            let engines = if all || (s * 7 + t) % 16 == 0 { &FAST[..] } else { &FAST[..2] };
            agree(&small(2, s), &tool(2, t, true), engines);
            agree(&small(2, s), &tool(2, t, false), &engines[1..]);
        }
    });
}

#[test]
fn a_hundred_thousand_random_pairs() {
    let all = all_pairs();
    (0..100u64).into_par_iter().for_each(|stream| {
        let mut r = rng(5, stream);
        for i in 0..1000 {
            let (s, t) = (r.next_u32() & r.next_u32(), r.next_u32() | 1 << 4);
            let engines = if all || i % 50 == 0 { &FAST[..] } else { &FAST[..2] };
            agree(&small(3, s), &tool(3, t & r.next_u32(), i % 2 == 0), engines);
        }
    });
}

#[test]
fn random_grids_with_round_tools_along_all_axes() {
    use Direction as D;
    (0..60u64).into_par_iter().for_each(|stream| {
        let mut r = rng(6, stream);
        let dims = [0, 1, 2].map(|_| 3 + r.next_u32() as usize % 22);
        let cells: Vec<bool> =
            (0..dims.iter().product()).map(|_| r.next_u32().is_multiple_of(40)).collect();
        let solid = BitGrid::from_fn(dims, |[x, y, z]| cells[x + dims[0] * (y + dims[1] * z)]);
        let mut radius = || f64::from(r.next_u32() % 40) / 10.0;
        // Every third tool undercuts.
        let (edge, neck, head) = (radius(), radius(), radius() + 3.0);
        let [a, b, c] = match stream % 3 {
            0 => [edge, neck, head],
            _ => [edge, edge + neck, edge + neck + head],
        };
        let layer = |z, end, r| Layer { z, end, plane: Element::disk(r) };
        let head = if stream % 2 == 0 { f64::INFINITY } else { c };
        let body = vec![layer(0, 3, a), layer(3, 7, b), layer(7, ENDLESS_UP, head)];
        let d = [D::X, D::NEG_X, D::Y, D::NEG_Y, D::Z, D::NEG_Z][stream as usize % 6];
        let tool = VoxelTool::of_elements(
            Element::from_layers(body),
            Element::from_layers(vec![layer(0, 3, a)]),
            Axis::of(d),
        );
        agree(&solid, &tool, &FAST);
    });
}

/// The fixture parts on grids of about 14 voxels along their longest side.
fn parts() -> Vec<(Frame, BitGrid)> {
    ["bearing", "blade", "block_bracket", "cross", "flange", "impeller"]
        .iter()
        .map(|name| {
            let path = format!("{}/fixtures/{name}_initial.obj", env!("CARGO_MANIFEST_DIR"));
            let options = crate::mesh::ReadOptions { mm_per_unit: 1.0 };
            let mesh = crate::mesh::read(path.as_ref(), &options).unwrap().mesh;
            let pitch = mesh.bounds().size().max_element() / 14.0;
            let frame = Frame::around(mesh.bounds(), pitch, 1).unwrap();
            let solid = voxelise(&mesh, &frame, &Ctx::quiet()).unwrap();
            (frame, solid)
        })
        .collect()
}

#[test]
fn presets_with_the_fixture_parts() {
    use Direction as D;
    let tools: Vec<Tool> =
        Tool::builtin_names().iter().map(|n| Tool::builtin(n).unwrap()).collect();
    parts().into_par_iter().for_each(|(frame, solid)| {
        for (i, tool) in tools.iter().enumerate() {
            let d = [D::Z, D::X, D::NEG_Y, D::NEG_Z][i % 4];
            let tool = match VoxelTool::along(tool, d, frame.pitch) {
                Ok(v) => v,
                // The bead of these nozzles is no part of their profile: the tip is the edge.
                Err(NoVoxelTool::NothingCuts { .. }) if tool.kind == ToolKind::Additive => {
                    VoxelTool::depositing(tool, d, frame.pitch).unwrap()
                }
                Err(e) => panic!("{}: {e}", tool.name),
            };
            agree(&solid, &tool, &FAST);
        }
    });
}

/// The depth engine with real heights along an axis never reaches less than tips at voxel
/// centres do.
#[test]
fn the_lattice_of_voxel_centres_is_a_restriction() {
    let cutter = Tool::builtin("w2v-cutter").unwrap();
    for (frame, solid) in parts() {
        for d in [Direction::Z, Direction::X] {
            let voxels = VoxelTool::along(&cutter, d, frame.pitch).unwrap();
            let mut found = accessible(Engine::Depth, &solid, &voxels);
            found.subtract(&solid);
            let air = crate::morph::complement(&solid);
            let scene = Scene::new(&frame, &solid, &[]);
            let map = cutter_map(&scene, &air, &cutter, d);
            // Wide sections count up to 12 % wider on pooled images; at this pitch none is pooled.
            assert!(found.is_subset_of(&reachable(&map, &air, &frame)), "{d:?}");
        }
    }
}

#[test]
fn regions_obey_their_laws() {
    (0..200u64).into_par_iter().for_each(|stream| {
        let mut r = rng(7, stream);
        let cells: Vec<u32> = (0..9 * 8 * 7).map(|_| r.next_u32() % 12).collect();
        let at = |[x, y, z]: [usize; 3]| cells[x + 9 * (y + 8 * z)];
        let solid = BitGrid::from_fn([9, 8, 7], |v| at(v) == 0);
        let more = BitGrid::from_fn([9, 8, 7], |v| at(v) <= 2);
        let t = tool(3, r.next_u32() & r.next_u32(), false);
        if t.edge().is_empty() {
            return;
        }
        let a = accessible(Engine::Bits, &solid, &t);
        // A ⊆ Oᶜ, since the edge is part of the tool; A and I make up the outside.
        assert!(!a.intersects(&solid));
        let i = inaccessible(Engine::Bits, &solid, &t);
        assert_eq!(a.or(&i).or(&solid).count(), 9 * 8 * 7);
        // More obstacle, or a larger tool, reaches less.
        assert!(accessible(Engine::Bits, &more, &t).is_subset_of(&a));
        let big = tool(3, u32::MAX, false);
        let larger = VoxelTool::of_elements(big.body().clone(), t.edge().clone(), None);
        assert!(accessible(Engine::Bits, &solid, &larger).is_subset_of(&a));
        // Opening by the edge's own shape is idempotent.
        let ball = VoxelTool::of_elements(t.edge().clone(), t.edge().clone(), None);
        let open = accessible(Engine::Bits, &solid, &ball);
        let again = accessible(Engine::Bits, &crate::morph::complement(&open), &ball);
        // Within the grid what is open stays open; outside it is free in both.
        assert_eq!(again, open);
        let turn = cardinal_rotations()[stream as usize % 24];
        let turned_tool =
            VoxelTool::of_elements(turned(t.body(), &turn), turned(t.edge(), &turn), None);
        let of_turned = accessible(Engine::Bits, &turn.of_grid(&solid), &turned_tool);
        assert_eq!(of_turned, turn.of_grid(&a));
    });
}

/// Algorithm 3 as the paper has it: one measure a contact.
#[test]
fn collateral_is_that_of_the_paper() {
    (0..60u64).into_par_iter().for_each(|stream| {
        let mut r = rng(8, stream);
        let part = small(3, r.next_u32() | r.next_u32());
        let t = tool(3, r.next_u32() & r.next_u32() | 1 << 4, false);
        let i = inaccessible(Engine::Naive, &part, &t);
        let ctx = Ctx::quiet();
        let offsets = |e: &Element| -> Vec<[i64; 3]> {
            e.chords().flat_map(|(z, c)| (c.x..c.x + c.len).map(move |x| [x, c.y, z])).collect()
        };
        let (body, edge) = (offsets(t.body()), offsets(t.edge()));
        let exposed: Vec<[i64; 3]> = edge
            .iter()
            .copied()
            .filter(|o| {
                (0..6).any(|n| {
                    let mut q = *o;
                    q[n / 2] += if n % 2 == 0 { 1 } else { -1 };
                    !body.contains(&q)
                })
            })
            .collect();
        let mut expected = BitGrid::new(part.dims());
        for x in i.iter_ones() {
            let hit = |k: &[i64; 3]| -> Vec<[i64; 3]> {
                body.iter()
                    .map(|b| std::array::from_fn(|a| x[a] as i64 - k[a] + b[a]))
                    .filter(|p| part.get_or_empty(*p))
                    .collect()
            };
            let best = exposed.iter().map(hit).min_by_key(Vec::len).unwrap();
            best.iter().for_each(|p| expected.set(p.map(|c| c as usize), true));
        }
        for engine in [None, Some(crate::morph::Engine::Naive)] {
            let found = upright(&part, &i, &t, &ctx, engine).unwrap();
            assert_eq!(found.region, expected, "{stream} {engine:?}");
        }
        assert_eq!(collateral(&part, &i, &t, &ctx).unwrap().region, expected);
    });
}

#[test]
fn the_choice_follows_the_tool() {
    let dims = [251, 315, 243];
    let cutter = Tool::builtin("w2v-cutter").unwrap();
    let along = VoxelTool::along(&cutter, Direction::Z, 0.5).unwrap();
    assert_eq!(choose(dims, &along).engine, Engine::Depth);
    // A T-slot cutter undercuts: heights cannot tell it.
    let layer = |z, end, r| Layer { z, end, plane: Element::disk(r) };
    let slot = Element::from_layers(vec![layer(0, 6, 9.0), layer(6, ENDLESS_UP, 4.0)]);
    let t_slot = VoxelTool::of_elements(
        slot,
        Element::from_layers(vec![layer(0, 6, 9.0)]),
        Axis::of(Direction::Z),
    );
    let chosen = choose(dims, &t_slot);
    assert_eq!((chosen.engine, chosen.depth_ms), (Engine::Bits, None));
    // A tilted one has thousands of chords.
    let within = Window { lo: [-80; 3], hi: [81; 3] };
    let tilted = Direction::new(crate::base::DVec3::new(0.3, 0.4, 0.8)).unwrap();
    let tilted = VoxelTool::turned(&cutter, tilted, 0.5, 0.0, &within);
    let chosen = choose(dims, &tilted);
    assert_eq!(chosen.engine, Engine::Fft, "{chosen:?}");
}
