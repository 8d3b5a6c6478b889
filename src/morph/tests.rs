//! What every engine must pass.

use super::*;
use crate::base::rng;
use proptest::prelude::*;
use rayon::prelude::*;

const FAST: [Engine; 2] = [Engine::Bits, Engine::Fft];

fn random(dims: [usize; 3], share: u32, r: &mut crate::base::Rng) -> BitGrid {
    let bits: Vec<bool> = (0..dims.iter().product()).map(|_| r.next_u32() % 100 < share).collect();
    BitGrid::from_fn(dims, |[x, y, z]| bits[x + dims[0] * (y + dims[1] * z)])
}

fn whole(dims: [usize; 3]) -> Window {
    Window { lo: [-3; 3], hi: dims.map(|n| n as i64 + 3) }
}

fn small(dims: [usize; 3], bits: u32) -> BitGrid {
    BitGrid::from_fn(dims, |[x, y, z]| bits >> (x + dims[0] * (y + dims[1] * z)) & 1 == 1)
}

/// The transform too goes through every pair, not only through some: half a minute more.
fn all_pairs() -> bool {
    std::env::var_os("HMPLAN_ALL_PAIRS").is_some()
}

#[test]
fn every_small_solid_with_every_small_element() {
    let all = all_pairs();
    (0..256u32).into_par_iter().for_each(|s| {
        let set = small([2, 2, 2], s);
        for e in 0..256 {
            let element = Element::from_grid(&small([2, 2, 2], e), [1, 0, 1]);
            let expected = naive::dilate(&set, &element, &whole([2, 2, 2]));
            let bits = bits::dilate(&set, &element, &whole([2, 2, 2]));
            assert_eq!(bits, expected, "{s:08b} {e:08b}");
            // The transform sees no more in the others, and takes long in the debug profile.
            if all || (s * 31 + e) % 5 == 0 {
                let fft = fft::dilate(&set, &element, &whole([2, 2, 2]));
                assert_eq!(fft, expected, "{s:08b} {e:08b}");
            }
        }
    });
}

#[test]
fn many_random_pairs() {
    let all = all_pairs();
    (0..100u64).into_par_iter().for_each(|stream| {
        let mut r = rng(11, stream);
        for i in 0..1000 {
            let set = small([3, 3, 3], r.next_u32());
            let element = Element::from_grid(&small([3, 3, 3], r.next_u32()), [1, 1, 1]);
            let window = whole([3, 3, 3]);
            let expected = naive::dilate(&set, &element, &window);
            assert_eq!(bits::dilate(&set, &element, &window), expected);
            if all || i % 20 == 0 {
                assert_eq!(fft::dilate(&set, &element, &window), expected);
            }
        }
    });
}

/// Layers as tools have them: disks, runs, endless ends, platforms.
fn element() -> impl Strategy<Value = Element> {
    let layer = (0u8..8, 0.0f64..7.0, 1i64..9, 0u8..8);
    (proptest::collection::vec(layer, 1..5), -6i64..4, any::<u64>(), any::<bool>()).prop_map(
        |(kinds, bottom, seed, flip)| {
            let mut r = rng(seed, 0);
            let mut z = bottom;
            let last = kinds.len() - 1;
            let mut layers = Vec::new();
            for (i, (kind, radius, deep, gap)) in kinds.into_iter().enumerate() {
                let plane = match kind {
                    0 => Plane::Whole,
                    1 | 2 => {
                        let grid = random([6, 6, 1], 30, &mut r);
                        match Element::from_grid(&grid, [4, 2, 0]).layers() {
                            [layer] => layer.plane.clone(),
                            _ => continue,
                        }
                    }
                    _ => Element::disk(radius),
                };
                let end = if i == last && gap > 3 { ENDLESS_UP } else { z + deep };
                layers.push(Layer { z, end, plane });
                z += deep + i64::from(gap == 1);
            }
            let e = Element::from_layers(layers);
            if flip { e.reflected() } else { e }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]
    #[test]
    fn engines_agree_on_random_grids(
        dims in [1usize..25, 1usize..25, 1usize..25], share in 1u32..20, element in element(),
        lo in [-9i64..9, -9i64..9, -9i64..9], size in [1i64..40, 1i64..30, 1i64..30],
        seed in any::<u64>(),
    ) {
        let set = random(dims, share, &mut rng(seed, 1));
        let window = Window { lo, hi: std::array::from_fn(|a| lo[a] + size[a]) };
        let expected = naive::dilate(&set, &element, &window);
        for engine in FAST {
            prop_assert_eq!(&dilate(engine, &set, &element, &window), &expected, "{:?}", engine);
        }
        let finite = element.clipped(&Window { lo: [-9; 3], hi: [9; 3] });
        let counts = naive::overlaps(&set, &finite, &window);
        prop_assert_eq!(overlaps(Engine::Fft, &set, &finite, &window), counts);
    }

    #[test]
    fn long_rows_agree_as_well(
        nx in 60usize..700, share in 1u32..6, radius in 0.0f64..70.0, centre in -40i64..40,
        deep in 1i64..9, seed in any::<u64>(),
    ) {
        let set = random([nx, 3, 3], share, &mut rng(seed, 2));
        let Plane::Chords(mut chords) = Element::disk(radius) else { unreachable!() };
        chords.retain(|c| c.y.abs() <= 3);
        chords.iter_mut().for_each(|c| c.x += centre);
        let layer = Layer { z: -1, end: deep, plane: Plane::Chords(chords) };
        let element = Element::from_layers(vec![layer]);
        let window = Window { lo: [-20, -2, -1], hi: [nx as i64 + 9, 4, 5] };
        let expected = naive::dilate(&set, &element, &window);
        prop_assert_eq!(bits::dilate(&set, &element, &window), expected);
    }

    #[test]
    fn laws_of_morphology(
        share in 1u32..60, e in any::<u32>(), more in any::<u32>(), seed in any::<u64>(),
        turn in 0usize..24, by in [0usize..4, 0usize..4, 0usize..4],
    ) {
        let mut r = rng(seed, 3);
        let dims = [9, 8, 7];
        let set = random(dims, share, &mut r);
        let grid = Window::of(dims);
        let wide = Window { lo: [-4; 3], hi: dims.map(|n| n as i64 + 4) };
        let b = Element::from_grid(&small([3, 3, 3], e | 1), [1, 1, 1]);
        let eroded = erode(Engine::Bits, &set, &b, &wide);
        // Duality: t is in S ⊖ B exactly when −B + t … does not leave S; by the definition.
        for t in eroded.iter_ones() {
            for (z, c) in b.chords() {
                for x in c.x..c.x + c.len {
                    let o = [x, c.y, z];
                    let p = std::array::from_fn(|a| t[a] as i64 + wide.lo[a] + o[a]);
                    prop_assert!(set.get_or_empty(p));
                }
            }
        }
        let opened = |s: &BitGrid| {
            let eroded = erode(Engine::Bits, s, &b, &wide);
            let from = Window { lo: [4; 3], hi: dims.map(|n| n as i64 + 4) };
            dilate(Engine::Bits, &eroded, &b, &from)
        };
        let once = opened(&set);
        prop_assert!(once.is_subset_of(&set), "anti-extensive");
        prop_assert_eq!(&opened(&once), &once, "idempotent");
        // Monotone in both.
        let larger = set.or(&random(dims, 20, &mut r));
        let big = Element::from_grid(&small([3, 3, 3], e | 1 | more), [1, 1, 1]);
        let d = dilate(Engine::Bits, &set, &b, &grid);
        prop_assert!(d.is_subset_of(&dilate(Engine::Bits, &larger, &b, &grid)));
        prop_assert!(d.is_subset_of(&dilate(Engine::Bits, &set, &big, &grid)));
        // Translation: the set moved within a larger grid, the window with it.
        let room: [usize; 3] = std::array::from_fn(|a| dims[a] + by[a]);
        let mut moved = BitGrid::new(room);
        set.iter_ones().for_each(|v| moved.set(std::array::from_fn(|a| v[a] + by[a]), true));
        let shifted = Window {
            lo: std::array::from_fn(|a| wide.lo[a] + by[a] as i64),
            hi: std::array::from_fn(|a| wide.hi[a] + by[a] as i64),
        };
        let here = dilate(Engine::Bits, &set, &b, &wide);
        prop_assert_eq!(&dilate(Engine::Bits, &moved, &b, &shifted), &here);
        // Rotation by right angles.
        let rotation = cardinal_rotations()[turn];
        let turned_set = rotation.of_grid(&set);
        let around = Window { lo: [-4; 3], hi: turned_set.dims().map(|n| n as i64 + 4) };
        let of_turned = dilate(Engine::Bits, &turned_set, &turned(&b, &rotation), &around);
        prop_assert_eq!(of_turned, rotation.of_grid(&here));
    }

    #[test]
    fn axes_turn_up_and_down_again(
        nx in 1usize..150, ny in 1usize..6, nz in 1usize..150, seed in any::<u64>(),
    ) {
        use crate::base::Direction as D;
        let set = random([nx, ny, nz], 20, &mut rng(seed, 4));
        for d in [D::X, D::NEG_X, D::Y, D::NEG_Y, D::Z, D::NEG_Z] {
            let axis = Axis::of(d).unwrap();
            let up = axis.up(&set);
            prop_assert_eq!(&axis.down(&up), &set);
            // Heights along the direction become heights along z, lowest at 0.
            for v in set.iter_ones().take(40) {
                let along: f64 = (0..3).map(|a| d.vec()[a] * v[a] as f64).sum();
                let n = up.dims()[2] as f64 - 1.0;
                let z = if along < 0.0 || d.vec().min_element() < 0.0 { along + n } else { along };
                let found = (0..up.dims()[1]).any(|y| {
                    (0..up.dims()[0]).any(|x| up.get([x, y, z as usize]))
                });
                prop_assert!(found);
            }
            prop_assert_eq!(up.count(), set.count());
        }
    }
}
