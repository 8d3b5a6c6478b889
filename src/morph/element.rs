//! Structuring elements: sets of voxel offsets, as layers of chords.

use crate::voxel::BitGrid;

/// A layer's upper end when it goes up without end.
pub const ENDLESS_UP: i64 = i64::MAX / 4;
/// A layer's lower end when it goes down without end.
pub const ENDLESS_DOWN: i64 = -ENDLESS_UP;

/// A run of offsets (x .. x + len, y) of one layer, in voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Chord {
    pub y: i64,
    pub x: i64,
    pub len: i64,
}

/// The cross-section of a layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Plane {
    /// Chords by (y, x), disjoint, none touching another of its row.
    Chords(Vec<Chord>),
    /// Every offset: a platform.
    Whole,
}

/// Offsets of one cross-section at the heights z .. end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layer {
    pub z: i64,
    pub end: i64,
    pub plane: Plane,
}

/// A set of offsets: what a solid is dilated or eroded by. Layers ascend and do not overlap; equal
/// neighbours are one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Element {
    layers: Vec<Layer>,
}

/// A box of positions or offsets lo .. hi, in voxels; empty when any hi is not above its lo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    pub lo: [i64; 3],
    pub hi: [i64; 3],
}

impl Window {
    /// The positions of a grid of `dims`.
    pub fn of(dims: [usize; 3]) -> Window {
        Window { lo: [0; 3], hi: dims.map(|n| n as i64) }
    }

    /// Numbers of positions along each axis.
    pub fn dims(&self) -> [usize; 3] {
        std::array::from_fn(|a| (self.hi[a] - self.lo[a]).max(0) as usize)
    }

    pub fn is_empty(&self) -> bool {
        self.dims().contains(&0)
    }

    /// {a + b}.
    pub fn plus(&self, o: &Window) -> Window {
        Window {
            lo: std::array::from_fn(|a| self.lo[a] + o.lo[a]),
            hi: std::array::from_fn(|a| self.hi[a] + o.hi[a] - 1),
        }
    }

    /// {a − b}.
    pub fn minus(&self, o: &Window) -> Window {
        self.plus(&o.reflected())
    }

    /// {−a}.
    pub fn reflected(&self) -> Window {
        Window { lo: self.hi.map(|h| 1 - h), hi: self.lo.map(|l| 1 - l) }
    }

    pub fn and(&self, o: &Window) -> Window {
        Window {
            lo: std::array::from_fn(|a| self.lo[a].max(o.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].min(o.hi[a])),
        }
    }

    /// The smallest box that holds both.
    pub fn hull(&self, o: &Window) -> Window {
        Window {
            lo: std::array::from_fn(|a| self.lo[a].min(o.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(o.hi[a])),
        }
    }
}

impl Element {
    /// Puts layers in order; layers must not overlap. Empty ones are dropped.
    pub fn from_layers(mut layers: Vec<Layer>) -> Element {
        layers.retain(|l| l.z < l.end && l.plane != Plane::Chords(Vec::new()));
        layers.sort_by_key(|l| l.z);
        let mut merged: Vec<Layer> = Vec::new();
        for layer in layers {
            match merged.last_mut() {
                Some(last) if last.end == layer.z && last.plane == layer.plane => {
                    last.end = layer.end;
                }
                _ => merged.push(layer),
            }
        }
        Element { layers: merged }
    }

    /// The solid voxels of a grid, offset so that its voxel `origin` becomes offset 0.
    pub fn from_grid(grid: &BitGrid, origin: [i64; 3]) -> Element {
        let mut layers: Vec<Layer> = Vec::new();
        for (y, z, x, len) in grid.runs() {
            let z = z as i64 - origin[2];
            let chord = Chord { y: y as i64 - origin[1], x: x as i64 - origin[0], len: len as i64 };
            match layers.last_mut() {
                Some(Layer { z: at, plane: Plane::Chords(chords), .. }) if *at == z => {
                    chords.push(chord);
                }
                _ => layers.push(Layer { z, end: z + 1, plane: Plane::Chords(vec![chord]) }),
            }
        }
        Element::from_layers(layers)
    }

    /// A set of offsets, in any order, repeats allowed.
    pub fn from_offsets(offsets: &[[i64; 3]]) -> Element {
        let mut sorted = offsets.to_vec();
        sorted.sort_by_key(|o| (o[2], o[1], o[0]));
        sorted.dedup();
        let mut layers: Vec<Layer> = Vec::new();
        for [x, y, z] in sorted {
            let mut layer = match layers.pop() {
                Some(l) if l.z == z => l,
                other => {
                    layers.extend(other);
                    Layer { z, end: z + 1, plane: Plane::Chords(Vec::new()) }
                }
            };
            if let Plane::Chords(chords) = &mut layer.plane {
                match chords.last_mut() {
                    Some(c) if c.y == y && c.x + c.len == x => c.len += 1,
                    _ => chords.push(Chord { y, x, len: 1 }),
                }
            }
            layers.push(layer);
        }
        Element::from_layers(layers)
    }

    /// One offset.
    pub fn point(o: [i64; 3]) -> Element {
        let plane = Plane::Chords(vec![Chord { y: o[1], x: o[0], len: 1 }]);
        Element::from_layers(vec![Layer { z: o[2], end: o[2] + 1, plane }])
    }

    /// The disk of offsets no further than `radius` voxels from the axis, as a cross-section.
    pub fn disk(radius: f64) -> Plane {
        if radius == f64::INFINITY {
            return Plane::Whole;
        }
        if radius.is_nan() || radius < 0.0 {
            return Plane::Chords(Vec::new());
        }
        // A radius of a whole number of voxels reaches its last voxel despite rounding.
        let squared = radius * radius * (1.0 + 1e-12);
        let n = squared.sqrt().floor() as i64;
        let chord = |y: i64| {
            let mut half = (squared - (y * y) as f64).max(0.0).sqrt().floor() as i64;
            while ((half + 1) * (half + 1) + y * y) as f64 <= squared {
                half += 1;
            }
            while half > 0 && (half * half + y * y) as f64 > squared {
                half -= 1;
            }
            Chord { y, x: -half, len: 2 * half + 1 }
        };
        Plane::Chords((-n..=n).map(chord).collect())
    }

    /// A ∪ B of finite elements.
    pub fn union(&self, other: &Element) -> Element {
        let offsets = |e: &Element| -> Vec<[i64; 3]> {
            e.chords().flat_map(|(z, c)| (c.x..c.x + c.len).map(move |x| [x, c.y, z])).collect()
        };
        Element::from_offsets(&[offsets(self), offsets(other)].concat())
    }

    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// {−b}.
    pub fn reflected(&self) -> Element {
        let plane = |p: &Plane| match p {
            Plane::Whole => Plane::Whole,
            Plane::Chords(chords) => Plane::Chords(
                chords
                    .iter()
                    .rev()
                    .map(|c| Chord { y: -c.y, x: 1 - c.x - c.len, len: c.len })
                    .collect(),
            ),
        };
        let turn = |z: i64| match z {
            ENDLESS_UP => ENDLESS_DOWN,
            ENDLESS_DOWN => ENDLESS_UP,
            z => 1 - z,
        };
        Element::from_layers(
            self.layers
                .iter()
                .map(|l| Layer { z: turn(l.end), end: turn(l.z), plane: plane(&l.plane) })
                .collect(),
        )
    }

    /// The offsets within a box; finite whatever the element.
    pub fn clipped(&self, to: &Window) -> Element {
        let rows = to.lo[1]..to.hi[1];
        let row = |y: i64, x: i64, end: i64| {
            let (x, end) = (x.max(to.lo[0]), end.min(to.hi[0]));
            (x < end && rows.contains(&y)).then_some(Chord { y, x, len: end - x })
        };
        let plane = |p: &Plane| -> Vec<Chord> {
            match p {
                Plane::Whole => rows.clone().filter_map(|y| row(y, to.lo[0], to.hi[0])).collect(),
                Plane::Chords(chords) => {
                    chords.iter().filter_map(|c| row(c.y, c.x, c.x + c.len)).collect()
                }
            }
        };
        Element::from_layers(
            self.layers
                .iter()
                .map(|l| Layer {
                    z: l.z.max(to.lo[2]),
                    end: l.end.min(to.hi[2]),
                    plane: Plane::Chords(plane(&l.plane)),
                })
                .collect(),
        )
    }

    /// The box of the offsets. Platforms and endless layers reach to the ends of the numbers;
    /// clip first where that matters.
    pub fn bounds(&self) -> Option<Window> {
        let wide = Window { lo: [ENDLESS_DOWN; 3], hi: [ENDLESS_UP; 3] };
        self.layers
            .iter()
            .map(|l| {
                let mut b = wide;
                if let Plane::Chords(c) = &l.plane {
                    let least = |f: fn(&Chord) -> i64| c.iter().map(f).min().unwrap_or(0);
                    let most = |f: fn(&Chord) -> i64| c.iter().map(f).max().unwrap_or(0);
                    b.lo = [least(|c| c.x), least(|c| c.y), 0];
                    b.hi = [most(|c| c.x + c.len), most(|c| c.y) + 1, 0];
                }
                (b.lo[2], b.hi[2]) = (l.z, l.end);
                b
            })
            .reduce(|a, b| a.hull(&b))
    }

    /// The chords as (z, chord), of a finite element.
    pub fn chords(&self) -> impl Iterator<Item = (i64, Chord)> + '_ {
        self.layers.iter().flat_map(|l| {
            let chords: &[Chord] = match &l.plane {
                Plane::Chords(c) => c,
                Plane::Whole => &[],
            };
            (l.z..l.end).flat_map(move |z| chords.iter().map(move |c| (z, *c)))
        })
    }

    /// Number of offsets of a finite element.
    pub fn count(&self) -> usize {
        let of = |l: &Layer| match &l.plane {
            Plane::Chords(c) => c.iter().map(|c| c.len as usize).sum::<usize>(),
            Plane::Whole => 0,
        };
        self.layers.iter().map(|l| of(l) * (l.end - l.z) as usize).sum()
    }

    /// Whether the element holds an offset.
    pub fn contains(&self, o: [i64; 3]) -> bool {
        self.layers.iter().filter(|l| (l.z..l.end).contains(&o[2])).any(|l| match &l.plane {
            Plane::Whole => true,
            Plane::Chords(c) => c.iter().any(|c| c.y == o[1] && (c.x..c.x + c.len).contains(&o[0])),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disks_hold_what_lies_within_the_radius() {
        for r in [0.0, 0.4, 1.0, 2f64.sqrt(), 2.5, 3.0, 9.0, 10.3] {
            let plane = Element::disk(r);
            let disk = Element::from_layers(vec![Layer { z: 0, end: 1, plane }]);
            for y in -12..=12i64 {
                for x in -12..=12i64 {
                    let within = ((x * x + y * y) as f64).sqrt() <= r + 1e-9;
                    assert_eq!(disk.contains([x, y, 0]), within, "{r} ({x}, {y})");
                }
            }
        }
        assert_eq!(Element::disk(f64::INFINITY), Plane::Whole);
    }

    #[test]
    fn reflection_and_clipping_are_what_they_say() {
        let plane =
            Plane::Chords(vec![Chord { y: 1, x: -1, len: 4 }, Chord { y: 2, x: 5, len: 1 }]);
        let e = Element::from_layers(vec![
            Layer { z: -2, end: 1, plane },
            Layer { z: 4, end: ENDLESS_UP, plane: Plane::Whole },
        ]);
        let turned = e.reflected();
        let near = Window { lo: [-6; 3], hi: [7; 3] };
        let clipped = e.clipped(&near);
        for z in -8..9i64 {
            for y in -8..9i64 {
                for x in -8..9i64 {
                    assert_eq!(e.contains([x, y, z]), turned.contains([-x, -y, -z]));
                    let inside = [x, y, z].iter().all(|c| (-6..7).contains(c));
                    assert_eq!(clipped.contains([x, y, z]), inside && e.contains([x, y, z]));
                }
            }
        }
        assert_eq!(clipped.count(), clipped.chords().map(|(_, c)| c.len as usize).sum::<usize>());
        assert_eq!(turned.reflected(), e);
    }
}
