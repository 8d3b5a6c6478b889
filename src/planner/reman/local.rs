//! Candidate local planes for what could not be made (W2V Sec. 4.2).
//!
//! Method. An *element* is a region that the blocks left, or a base that no flat layer fits. For
//! each of the sampled normals a plane lies just below it; what it gives up are the pieces of the
//! reused volume over the plane that touch the element, and, again and again, those that a nozzle
//! along the normal would meet while it prints the element and what is given up. So what a
//! candidate gives up can be printed along its own normal as far as the reused volume is concerned.
//!
//! All of it is done on a coarse grid, whose voxels are the *cells* of the dependency graph.

use super::coarse::Coarse;
use super::setting::Setting;
use crate::access::{CellSet, Cells, Scene, nozzle_map, reachable};
use crate::base::{DVec3, Direction};
use crate::machine::{HoldingMode, Tool};
use crate::plan::{Job, Plane};
use crate::region::steady;
use crate::voxel::{BitGrid, Components, Connectivity, components};
use rayon::prelude::*;

/// Something that a plane is to free.
#[derive(Clone, Debug)]
pub struct Element {
    /// Its voxels on the coarse grid.
    pub region: BitGrid,
    /// Nothing but a plane over it will do: tools reach it while all of the reused volume stands,
    /// and yet the blocks left it.
    pub must: bool,
}

/// A local plane for an element.
#[derive(Clone, Debug)]
pub struct Candidate {
    pub plane: Plane,
    /// The pieces it gives up, on the coarse grid.
    pub seeds: BitGrid,
    /// Cells it gives up, with those that nothing holds any more.
    pub lost: CellSet,
    pub lost_count: usize,
    /// Elements that it clears, ascending.
    pub clears: Vec<usize>,
}

/// Candidates kept per element, those that give up least: a search of some hundred iterations
/// sees no more.
const KEPT: usize = 24;

/// Planes tried at most, some milliseconds each; with many elements every n-th normal stays.
const MOST_TRIED: usize = 500;

/// Depths below an element, in cells, at which a plane is tried for the normals that give up least.
const DEEPER: [f64; 2] = [2.0, 5.0];

/// Where planes are looked for.
pub struct Scope<'a> {
    pub setting: &'a Setting<'a>,
    /// The job on the cells' grid.
    pub job: &'a Job,
    pub cells: Cells,
    reused: BitGrid,
    contact: BitGrid,
    /// What stands still beside the part.
    pub fixed: Vec<Vec<DVec3>>,
}

impl<'a> Scope<'a> {
    pub fn new(setting: &'a Setting<'a>, look: &'a Coarse, reused: &BitGrid) -> Scope<'a> {
        let job = &look.job;
        let reused = look.most(reused);
        let contact = match job.rules.holding {
            HoldingMode::Base => {
                setting.holdings[0].contact(&reused, &job.frame, job.rules.grip_mm)
            }
            HoldingMode::Refixture => BitGrid::new(reused.dims()),
        };
        let fixed =
            (0..setting.holdings.len()).map(|h| setting.fixed(h, &setting.job.initial)).collect();
        let cells = Cells::of(&job.frame, &reused);
        Scope { setting, job, cells, reused, contact, fixed }
    }

    /// The holding in which a nozzle can point along `normal`.
    pub fn holding(&self, normal: Direction) -> Option<usize> {
        (0..self.setting.holdings.len()).find(|h| self.setting.can_point(*h, normal))
    }

    /// The candidates of every element, those that give up least first.
    pub fn candidates(&self, elements: &[Element], normals: &[Direction]) -> Vec<Vec<Candidate>> {
        let stride = (elements.len() * normals.len()).div_ceil(MOST_TRIED).max(1);
        let normals = || normals.iter().step_by(stride);
        let ways: Vec<(usize, Direction)> =
            (0..elements.len()).flat_map(|e| normals().map(move |n| (e, *n))).collect();
        let found: Vec<(usize, Option<Candidate>)> =
            ways.par_iter().map(|(e, n)| (*e, self.candidate(elements, *e, *n, 0.0))).collect();
        let mut of = vec![Vec::new(); elements.len()];
        found.into_iter().for_each(|(e, c)| of[e].extend(c));
        of.iter_mut().for_each(|of: &mut Vec<Candidate>| {
            of.sort_by_key(|c| c.lost_count);
            of.truncate(KEPT);
        });
        let deeper: Vec<Vec<Candidate>> = of
            .par_iter()
            .enumerate()
            .map(|(e, of)| {
                let normals = of.iter().take(KEPT / 4).map(|c| c.plane.normal);
                let down = normals.flat_map(|n| DEEPER.iter().map(move |d| (n, *d)));
                down.filter_map(|(n, d)| self.candidate(elements, e, n, d)).collect()
            })
            .collect();
        of.iter_mut().zip(deeper).for_each(|(of, deeper)| {
            of.extend(deeper);
            of.sort_by_key(|c| c.lost_count);
        });
        of
    }

    /// The plane across `normal`, `down` cells below an element; none where it takes the base
    /// contact, frees nothing, or points where no nozzle can.
    fn candidate(
        &self,
        elements: &[Element],
        element: usize,
        normal: Direction,
        down: f64,
    ) -> Option<Candidate> {
        let frame = &self.job.frame;
        let points = elements[element].region.iter_ones();
        let lowest = points.map(|v| normal.dot(frame.center(v))).fold(f64::INFINITY, f64::min);
        let offset = lowest - (0.5 + down) * frame.pitch;
        self.at(elements, element, Plane { normal, offset })
    }

    /// What a plane gives up for an element.
    pub fn at(&self, elements: &[Element], element: usize, plane: Plane) -> Option<Candidate> {
        let frame = &self.job.frame;
        self.holding(plane.normal)?;
        let over = crate::region::above(&self.reused, frame, plane.normal.vec(), plane.offset);
        let region = &elements[element].region;
        let pieces = components(&over, Connectivity::Edge18);
        let mut taken = vec![false; pieces.count()];
        for v in region.grown().iter_ones() {
            if let Some(p) = pieces.label_of(v) {
                taken[p as usize] = true;
            }
        }
        self.take_blockers(&pieces, &mut taken, region, plane.normal);
        let seeds = pieces.grid_where(|p| taken[p as usize]);
        if seeds.is_empty() || seeds.intersects(&self.contact) {
            return None;
        }
        let rules = &self.job.rules;
        let standing = self.reused.minus(&seeds);
        let held = steady(&standing, frame, rules.holding, rules.grip_mm);
        if held.is_empty() {
            return None;
        }
        let lost = self.cells.set_of(&self.reused.minus(&held));
        let clears = (0..elements.len())
            .filter(|&e| e == element || self.is_clear(&elements[e].region, &over, &seeds, &plane))
            .collect();
        Some(Candidate { plane, seeds, lost_count: lost.count(), lost, clears })
    }

    /// Takes the pieces that a nozzle would meet while it prints what is taken and the region.
    fn take_blockers(
        &self,
        pieces: &Components,
        taken: &mut [bool],
        region: &BitGrid,
        normal: Direction,
    ) {
        let Some(nozzle) = Tool::longest(&self.job.nozzles) else { return };
        while taken.iter().any(|t| !t) {
            let wanted = region.or(&pieces.grid_where(|p| taken[p as usize]));
            let mut more = false;
            for piece in (0..taken.len()).filter(|p| !taken[*p]).collect::<Vec<_>>() {
                let scene = Scene::new(&self.job.frame, &pieces.grid_of(piece as u32), &[]);
                let dip = self.job.rules.nozzle_dip_mm;
                let map = nozzle_map(&scene, &wanted, nozzle, normal, dip);
                if reachable(&map, &wanted, &self.job.frame) != wanted {
                    taken[piece] = true;
                    more = true;
                }
            }
            if !more {
                break;
            }
        }
    }

    /// Whether a plane that gives up `seeds` of what lies `over` it clears a region too.
    fn is_clear(&self, region: &BitGrid, over: &BitGrid, seeds: &BitGrid, plane: &Plane) -> bool {
        let frame = &self.job.frame;
        let above = region.iter_ones().all(|v| plane.normal.dot(frame.center(v)) > plane.offset);
        let beside = region.grown().and(over);
        above && !beside.is_empty() && beside.is_subset_of(seeds)
    }
}
