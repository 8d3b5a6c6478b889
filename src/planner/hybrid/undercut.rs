//! Under-cut (HB Sec. 4.1.2, Alg. 7): all of P_i − P goes, and with it as little of P as need be.
//!
//! P_o = P_o − C(P_o, P, T, K, R) (Eq. 29) from O₀ = P_i ∩ P: while something that is to go is out
//! of reach, tool positions are chosen that touch it, and what the tool meets there goes as well.
//! A tool that goes up without end cuts columns off at a height, so O stays O₀ with its columns
//! cut short.
//!
//! | symbol | here |
//! |---|---|
//! | I ∩ (P_i − O) | the lowest voxel out of reach of each column: `needs` |
//! | T + t | [`Footprint`]: height of the tool's lower surface by offset from its tip |
//! | C | what [`Columns::cut`] takes |
//!
//! Differs from the paper: Alg. 3 takes for every point the contact of least collision, whatever
//! the others take; here points are served from the deepest up, each by the contact that hits least
//! of what the contacts before it left (a greedy cover by marginal cost), so that neighbours share
//! a contact. Wide sections are drawn wider, as the depth engine does. Pieces that would come loose
//! count as what is to go.
//!
//! Guarantees: P_o ⊆ P, and every voxel of P_i − P_o is reached in P_o. Not guaranteed: that the
//! collateral is the least possible.

use super::cutting::reached;
use super::site::{Site, held};
use crate::base::{Cancelled, Ctx, DVec2, DVec3};
use crate::machine::Tool;
use crate::plan::Job;
use crate::voxel::BitGrid;
use std::collections::HashMap;

/// Rounds before an under-cut is given up: each frees what the round before uncovered, and a tool
/// has few sections to uncover.
const MOST_ROUNDS: usize = 40;

/// Slack of heights in mm, ten times that of the depth engine.
const SLACK_MM: f64 = 1e-3;

/// Radius in cells up to which the depth engine draws a section as it is.
const EXACT_CELLS: f64 = 24.0;

/// Contacts tried for a voxel: more find a slightly lesser collision, at cost in proportion.
const MOST_CONTACTS: usize = 24;

/// How finely heights are listed by their radius.
const RADII_PER_CELL: f64 = 8.0;

/// Voxels whose least collision bounds that of an under-cut from below.
const BOUND_SAMPLES: usize = 12;

/// Cells looked at for that bound, over all contacts: a second or two. Usual cutters stay a hundredfold
/// below it; one larger than the part has more contacts than it has cells for, and no end of them.
const BOUND_CELLS: usize = 50_000_000;

/// The tool's lower surface over the cells around its tip.
pub struct Footprint {
    /// (i, j, height over the tip), nearest first.
    cells: Vec<(i64, i64, f64)>,
    /// Some of the cells with the number of cells each stands for.
    sampled: Vec<(i64, i64, f64, f64)>,
    /// (i, j, k): contacts of the edge, nearest first.
    contacts: Vec<(i64, i64, f64)>,
    /// Height at every [`RADII_PER_CELL`]-th of a cell from the axis, as far as there is a tool.
    heights: Vec<f64>,
}

impl Footprint {
    /// Of a tool on columns of `dims`, `pitch` mm apart.
    pub fn new(tool: &Tool, pitch: f64, dims: [usize; 3]) -> Footprint {
        let most = dims[0].max(dims[1]) as i64;
        let widened: Vec<(f64, _)> = tool
            .sections
            .iter()
            .map(|s| {
                let cells = s.shape.max_radius() / pitch;
                let mut pool = 1.0;
                while cells.is_finite() && cells / pool > EXACT_CELLS {
                    pool *= 2.0;
                }
                let by = if pool > 1.0 { (2.0 * pool + 1.0) * pitch } else { 0.0 };
                (by, s.shape)
            })
            .collect();
        let radius = widened.iter().map(|(by, s)| s.max_radius() + by).fold(0.0, f64::max);
        let reach =
            if radius.is_finite() { ((radius / pitch).ceil() as i64).min(most) } else { most };
        let lower = |rho: f64| {
            let of = widened.iter().map(|(by, s)| s.lower_surface((rho - by).max(0.0)));
            of.fold(f64::INFINITY, f64::min)
        };
        let around = |reach: i64, f: &dyn Fn(f64) -> f64| {
            let mut cells: Vec<(i64, i64, f64)> = Vec::new();
            for j in -reach..=reach {
                for i in -reach..=reach {
                    let z = f(DVec2::new(i as f64, j as f64).length() * pitch);
                    if z.is_finite() {
                        cells.push((i, j, z));
                    }
                }
            }
            cells.sort_by_key(|(i, j, _)| (i * i + j * j, *j, *i));
            cells
        };
        let cells = around(reach, &lower);
        let edge = (tool.active_radius() / pitch).floor() as i64;
        let contacts = around(edge, &|rho| tool.active_lower_surface(rho));
        // Far cells are many and alike: every third or eighth along each axis stands for the rest.
        let sampled = cells
            .iter()
            .filter_map(|&(i, j, z)| {
                let far = i.abs().max(j.abs());
                let step = if far < 8 {
                    1
                } else if far < 32 {
                    3
                } else {
                    8
                };
                (i % step == 0 && j % step == 0).then_some((i, j, z, (step * step) as f64))
            })
            .collect();
        let heights = (0..)
            .map(|k| lower(f64::from(k) / RADII_PER_CELL * pitch))
            .take((RADII_PER_CELL * (reach as f64 + 1.0)) as usize)
            .take_while(|z| z.is_finite())
            .collect();
        Footprint { cells, sampled, contacts, heights }
    }
}

/// A solid by columns: how much of each lies above a height, and where it was cut off.
struct Columns {
    nx: i64,
    ny: i64,
    nz: usize,
    pitch: f64,
    /// Per column, of each layer the solid voxels in it and above.
    from: Vec<u16>,
    /// Per column the first layer cut off, and the solid voxels in it and above.
    top: Vec<u32>,
    lost: Vec<u16>,
    /// The first layer over everything.
    roof: usize,
}

impl Columns {
    fn of(grid: &BitGrid, pitch: f64) -> Columns {
        let [nx, ny, nz] = grid.dims();
        let mut from = vec![0u16; nx * ny * (nz + 1)];
        for z in (0..nz).rev() {
            for y in 0..ny {
                let row = grid.row(y, z);
                for x in 0..nx {
                    let at = (x + nx * y) * (nz + 1) + z;
                    from[at] = from[at + 1].saturating_add((row[x / 64] >> (x % 64) & 1) as u16);
                }
            }
        }
        let (top, lost) = (vec![nz as u32; nx * ny], vec![0; nx * ny]);
        let roof = grid.extent().map_or(0, |(_, hi)| hi[2] + 1);
        Columns { nx: nx as i64, ny: ny as i64, nz, pitch, from, top, lost, roof }
    }

    fn column(&self, x: i64, y: i64) -> Option<usize> {
        let inside = (0..self.nx).contains(&x) && (0..self.ny).contains(&y);
        inside.then(|| (x + self.nx * y) as usize)
    }

    /// The first layer whose centre lies higher than a height.
    fn layer_above(&self, height: f64) -> usize {
        ((height / self.pitch + 0.5).floor().max(0.0) as usize).min(self.nz)
    }

    /// Solid voxels of a column from a layer up, less what was cut off.
    fn above(&self, column: usize, layer: usize) -> u16 {
        self.from[column * (self.nz + 1) + layer].saturating_sub(self.lost[column])
    }

    /// What a tool with its tip at a height over (x, y) meets, about; infinite beyond `limit`.
    fn met(&self, [x, y]: [i64; 2], tip: f64, foot: &Footprint, limit: f64) -> f64 {
        let mut sum = 0.0;
        for &(i, j, z, weight) in &foot.sampled {
            // Cells come nearest first, and a lower surface only rises outward.
            let layer = self.layer_above(tip + z - SLACK_MM);
            if layer >= self.roof {
                break;
            }
            if let Some(c) = self.column(x + i, y + j) {
                sum += weight * f64::from(self.above(c, layer));
                if sum >= limit {
                    return f64::INFINITY;
                }
            }
        }
        sum
    }

    /// Cuts off what a tool with its tip there meets.
    fn cut(&mut self, [x, y]: [i64; 2], tip: f64, foot: &Footprint) {
        for &(i, j, z) in &foot.cells {
            let layer = self.layer_above(tip + z - SLACK_MM);
            if layer >= self.roof {
                break;
            }
            if let Some(c) = self.column(x + i, y + j).filter(|c| layer < self.top[*c] as usize) {
                self.top[c] = layer as u32;
                self.lost[c] = self.from[c * (self.nz + 1) + layer];
            }
        }
    }

    /// What is left of a grid.
    fn left(&self, grid: &BitGrid) -> BitGrid {
        let mut out = grid.clone();
        let [nx, ny, nz] = grid.dims();
        for (c, top) in self.top.iter().enumerate().filter(|(_, t)| (**t as usize) < nz) {
            let (x, y) = (c % nx, c / nx % ny);
            (*top as usize..nz).for_each(|z| out.set([x, y, z], false));
        }
        out
    }
}

/// The lowest voxel of each column: x, y and the height of its centre, the deepest first.
fn needs(left: &BitGrid, pitch: f64) -> Vec<([i64; 2], f64)> {
    let [_, ny, nz] = left.dims();
    let mut needs = Vec::new();
    let mut open = vec![!0u64; left.words_per_row() * ny];
    for z in 0..nz {
        for y in 0..ny {
            for (w, bits) in left.row(y, z).iter().enumerate() {
                let open = &mut open[y * left.words_per_row() + w];
                let mut new = bits & *open;
                *open &= !bits;
                while new != 0 {
                    let x = w * 64 + new.trailing_zeros() as usize;
                    needs.push(([x as i64, y as i64], (z as f64 + 0.5) * pitch));
                    new &= new - 1;
                }
            }
        }
    }
    needs
}

/// What an under-cut leaves, in turned coordinates; none where the tool cannot come to all of
/// P_i − P, or nothing would be left.
///
/// # Errors
/// [`Cancelled`] when the user has asked to stop.
pub fn under_cut(
    job: &Job,
    site: &Site,
    tool: &Tool,
    ctx: &Ctx,
) -> Result<Option<BitGrid>, Cancelled> {
    let frame = &site.view.frame;
    let mut left = site.state.and(&site.view.target);
    let foot = Footprint::new(tool, frame.pitch, frame.dims);
    let fixed = Fixed::of(&site.fixed);
    let mut columns: Option<Columns> = None;
    for _ in 0..MOST_ROUNDS {
        let gone = site.state.minus(&left);
        let hidden = gone.minus(&reached(site, &left, &gone, tool));
        if !hidden.is_empty() {
            let columns = columns.get_or_insert_with(|| Columns::of(&left, frame.pitch));
            serve(columns, &foot, &needs(&hidden, frame.pitch), &fixed, ctx)?;
            let next = columns.left(&left);
            if next == left {
                return Ok(None);
            }
            left = next;
            continue;
        }
        let standing = held(job, &site.view.down(&left));
        if standing.is_empty() {
            return Ok(None);
        }
        let standing = site.view.up(&standing);
        if standing == left {
            return Ok(Some(left));
        }
        left = standing;
        columns = None;
    }
    Ok(None)
}

/// Chooses contacts for what is needed, the deepest first, and cuts what the tool meets there.
fn serve(
    columns: &mut Columns,
    foot: &Footprint,
    needs: &[([i64; 2], f64)],
    fixed: &Fixed,
    ctx: &Ctx,
) -> Result<(), Cancelled> {
    let stride = foot.contacts.len().div_ceil(MOST_CONTACTS).max(1);
    // Lowest height from which each column is served by the contacts chosen so far.
    let mut served = vec![f64::INFINITY; (columns.nx * columns.ny) as usize];
    for &([x, y], z) in needs {
        let Some(own) = columns.column(x, y) else { continue };
        if z >= served[own] {
            continue;
        }
        ctx.check()?;
        let mut best: Option<(f64, [i64; 2], f64)> = None;
        for &(i, j, k) in foot.contacts.iter().step_by(stride) {
            // The tip stands off so that its edge, at (−i, −j) from it, touches the voxel.
            let (at, tip) = ([x + i, y + j], z - k - 2.0 * SLACK_MM);
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.0);
            let met = columns.met(at, tip, foot, limit);
            if met < limit && fixed.is_clear_of(at, tip, foot, columns.pitch) {
                best = Some((met, at, tip));
            }
        }
        let Some((_, at, tip)) = best else { continue };
        columns.cut(at, tip, foot);
        for &(i, j, k) in &foot.contacts {
            if let Some(c) = columns.column(at[0] + i, at[1] + j) {
                served[c] = served[c].min(tip + k + 2.0 * SLACK_MM);
            }
        }
    }
    Ok(())
}

/// What holds the part, the highest point of each place across the direction, from the highest down.
pub struct Fixed(Vec<DVec3>);

impl Fixed {
    pub fn of(points: &[DVec3]) -> Fixed {
        let mut highest: Vec<DVec3> = points.to_vec();
        highest.sort_by(|a, b| {
            a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(b.z.total_cmp(&a.z))
        });
        highest.dedup_by_key(|p| p.truncate());
        highest.sort_by(|a, b| b.z.total_cmp(&a.z));
        Fixed(highest)
    }

    /// Whether a tool with its tip over a cell meets none of it.
    pub fn is_clear_of(&self, [x, y]: [i64; 2], tip: f64, foot: &Footprint, pitch: f64) -> bool {
        let centre = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * pitch;
        // A lower surface lies nowhere under the tip.
        self.0.iter().take_while(|p| p.z > tip).all(|p| {
            // A cell nearer to the axis, so that no point is met by a hair.
            let cells = (p.truncate().distance(centre) / pitch - 1.0).max(0.0);
            let height = foot.heights.get((cells * RADII_PER_CELL) as usize);
            height.is_none_or(|h| p.z <= tip + h)
        })
    }
}

/// A number of voxels of P_i ∩ P that any under-cut takes, given what of P_i − P is hidden while
/// all of P_i ∩ P stands: whoever touches a hidden voxel meets at least what its best contact does.
pub fn least_collateral(site: &Site, hidden: &BitGrid, tool: &Tool) -> usize {
    let pitch = site.view.frame.pitch;
    let needs = needs(hidden, pitch);
    let keep = site.state.and(&site.view.target);
    // Only the narrow part of the tool is drawn, as it is: fewer cells bound from below as well.
    let near = tool.active_radius() + 2.0 * pitch;
    let cells: Vec<(i64, i64, f64)> = Footprint::new(tool, pitch, [1 + (near / pitch) as usize; 3])
        .cells
        .into_iter()
        .map(|(i, j, _)| (i, j, tool.lower_surface(((i * i + j * j) as f64).sqrt() * pitch)))
        .collect();
    let contacts = Footprint::new(tool, pitch, [1; 3]).contacts;
    // The nearest of them, the fewer the more contacts there are.
    let cells = &cells[..cells.len().min(BOUND_CELLS / BOUND_SAMPLES / contacts.len().max(1))];
    let stride = needs.len().div_ceil(BOUND_SAMPLES).max(1);
    let [nx, ny, nz] = keep.dims();
    // Of each column looked at, the solid voxels from every layer up.
    let mut towers: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    let tower = |x: i64, y: i64| {
        let mut from = vec![0; nz + 1];
        for z in (0..nz).rev() {
            from[z] = from[z + 1] + usize::from(keep.get([x as usize, y as usize, z]));
        }
        from
    };
    let mut met = |[x, y]: [i64; 2], tip: f64, limit: usize| {
        let mut sum = 0;
        for (i, j, z) in cells {
            let (x, y) = (x + i, y + j);
            if x < 0 || y < 0 || x >= nx as i64 || y >= ny as i64 || !z.is_finite() {
                continue;
            }
            let first = ((tip + z + SLACK_MM) / pitch + 0.5).floor().max(0.0) as usize;
            sum += towers.entry((x, y)).or_insert_with(|| tower(x, y))[first.min(nz)];
            if sum >= limit {
                break;
            }
        }
        sum
    };
    let mut least = |&([x, y], z): &([i64; 2], f64)| {
        contacts
            .iter()
            .fold(usize::MAX, |least, &(i, j, k)| least.min(met([x + i, y + j], z - k, least)))
    };
    needs
        .iter()
        .step_by(stride)
        .map(&mut least)
        .filter(|n| *n < usize::MAX)
        .max()
        .unwrap_or(0)
        .max(1)
}
