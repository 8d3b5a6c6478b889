//! INV's schedule file: when each voxel of a box is deposited and when it is cut.
//!
//! Line 1 holds tEnd, the time of the last operation; then one line a voxel, x fastest, then y,
//! then z: AM time and SM time with a comma between. A time above tEnd is none.
//!
//! Guarantees: what is read has one line for each voxel, no time twice, and no cut before the
//! deposit. Not guaranteed: that it can be made; the verifier's replay says so.

use super::{Deed, Operation};
use std::io::{self, Write};

/// Times count from 1; 0 stands for none here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedule {
    dims: [usize; 3],
    end: u32,
    /// AM and SM time of each voxel, x fastest, then y, then z.
    times: Vec<[u32; 2]>,
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ScheduleError {
    #[error("line {line}: \"{found}\" is not {expected}")]
    Number { line: usize, found: String, expected: &'static str },
    #[error("it has {found} voxels, the box {x} × {y} × {z} has {expected}; it is of another plan")]
    Count { found: usize, expected: usize, x: usize, y: usize, z: usize },
    #[error("line {line}: time {time} is given to two operations")]
    Twice { line: usize, time: u32 },
    #[error("line {line}: the voxel is cut at {cut}, before it is deposited at {added}")]
    Order { line: usize, added: u32, cut: u32 },
    #[error("voxel {voxel:?} has two operations of one kind, which a schedule cannot say")]
    Repeated { voxel: [u16; 3] },
}

impl Schedule {
    /// The schedule of operations in order, on a box of `dims` voxels.
    ///
    /// # Errors
    /// A voxel that is deposited or cut twice.
    pub fn new(dims: [usize; 3], operations: &[Operation]) -> Result<Schedule, ScheduleError> {
        let mut times = vec![[0u32; 2]; dims.iter().product()];
        for (t, op) in operations.iter().enumerate() {
            let [x, y, z] = op.voxel.map(usize::from);
            let slot =
                &mut times[x + dims[0] * (y + dims[1] * z)][usize::from(op.deed != Deed::Add)];
            if *slot != 0 {
                return Err(ScheduleError::Repeated { voxel: op.voxel });
            }
            *slot = t as u32 + 1;
        }
        Ok(Schedule { dims, end: operations.len() as u32, times })
    }

    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// The operations in order; how a cut is oriented is not in the file.
    pub fn operations(&self) -> Vec<Operation> {
        let [nx, ny, _] = self.dims;
        let mut timed: Vec<(u32, Operation)> = Vec::new();
        for (i, [added, cut]) in self.times.iter().enumerate() {
            let voxel = [i % nx, i / nx % ny, i / nx / ny].map(|c| c as u16);
            for (time, deed) in [(*added, Deed::Add), (*cut, Deed::CutAnyhow)] {
                if time != 0 {
                    timed.push((time, Operation { voxel, deed }));
                }
            }
        }
        timed.sort_unstable_by_key(|(t, _)| *t);
        timed.into_iter().map(|(_, op)| op).collect()
    }

    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let none = u64::from(self.end) + 1;
        let shown = |t: u32| if t == 0 { none } else { u64::from(t) };
        writeln!(out, "{}", self.end)?;
        self.times.iter().try_for_each(|[a, c]| writeln!(out, "{},{}", shown(*a), shown(*c)))
    }

    /// Reads the schedule of a box of `dims` voxels.
    ///
    /// # Errors
    /// What is no number, a count that is not the box's, a time given twice, a cut before its
    /// deposit.
    pub fn parse(text: &str, dims: [usize; 3]) -> Result<Schedule, ScheduleError> {
        let number = |line: usize, found: &str, expected| {
            found.trim().parse::<u64>().map_err(|_| ScheduleError::Number {
                line,
                found: found.chars().take(40).collect(),
                expected,
            })
        };
        let mut lines = text.lines();
        let end = number(1, lines.next().unwrap_or_default(), "the time of the last operation")?;
        let voxels: usize = dims.iter().product();
        // Every operation has a voxel of its own kind, so later times cannot be.
        let end = u32::try_from(end).ok().filter(|e| u64::from(*e) <= 2 * voxels as u64 + 2);
        let found = text.lines().skip(1).filter(|l| !l.trim().is_empty()).count();
        let [x, y, z] = dims;
        let (Some(end), true) = (end, found == voxels) else {
            return Err(ScheduleError::Count { found, expected: voxels, x, y, z });
        };
        let mut used = vec![false; end as usize + 1];
        let mut times = Vec::with_capacity(voxels);
        for (i, text) in lines.enumerate().filter(|(_, l)| !l.trim().is_empty()) {
            let line = i + 2;
            let (added, cut) = text.split_once(',').unwrap_or((text, ""));
            let mut pair = [0u32; 2];
            for (slot, word) in pair.iter_mut().zip([added, cut]) {
                let time = number(line, word, "a time; a line holds AM time, SM time")?;
                if time > u64::from(end) {
                    continue;
                }
                if std::mem::replace(&mut used[time as usize], true) {
                    return Err(ScheduleError::Twice { line, time: time as u32 });
                }
                *slot = time as u32 + 1;
            }
            if pair[0] != 0 && pair[1] != 0 && pair[1] < pair[0] {
                return Err(ScheduleError::Order { line, added: pair[0] - 1, cut: pair[1] - 1 });
            }
            times.push(pair);
        }
        // Some writers count from 0. Here 0 is no time.
        let from_zero = used[0];
        for time in times.iter_mut().flatten().filter(|t| **t != 0) {
            *time -= u32::from(!from_zero);
        }
        Ok(Schedule { dims, end: end + u32::from(from_zero), times })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Orientation;

    fn example() -> (Vec<Operation>, Schedule) {
        let op = |voxel, deed| Operation { voxel, deed };
        let ops = vec![
            op([0, 0, 0], Deed::Add),
            op([1, 0, 0], Deed::Add),
            op([1, 0, 1], Deed::Add),
            op([0, 0, 0], Deed::Cut(Orientation::PlusX)),
        ];
        let schedule = Schedule::new([2, 1, 2], &ops).unwrap();
        (ops, schedule)
    }

    #[test]
    fn a_schedule_survives_its_file() {
        let (ops, schedule) = example();
        let mut file = Vec::new();
        schedule.write(&mut file).unwrap();
        let text = String::from_utf8(file).unwrap();
        assert_eq!(text, "4\n1,4\n2,5\n5,5\n3,5\n");
        let again = Schedule::parse(&text, [2, 1, 2]).unwrap();
        assert_eq!(again, schedule);
        let again = again.operations();
        assert_eq!(again.len(), ops.len());
        for (a, b) in again.iter().zip(&ops) {
            assert_eq!((a.voxel, a.deed == Deed::Add), (b.voxel, b.deed == Deed::Add));
        }
    }

    #[test]
    fn what_is_no_schedule_is_said() {
        let dims = [2, 1, 1];
        for (text, word) in [
            ("", "line 1"),
            ("x\n", "line 1"),
            ("2\n1,3\n", "1 voxels"),
            ("99999999999\n1,3\n2,3\n", "of another plan"),
            ("2\n1,3\n1,3\n", "two operations"),
            ("2\n2,1\n3,3\n", "before it is deposited"),
            ("2\n1\n2,3\n", "line 2"),
        ] {
            let said = Schedule::parse(text, dims).unwrap_err().to_string();
            assert!(said.contains(word), "{text:?}: {said}");
        }
        assert!(Schedule::parse("1\n0,9\n1,9\n", dims).is_ok(), "times may count from 0");
    }

    #[test]
    fn an_operation_that_comes_twice_is_refused() {
        let (mut ops, _) = example();
        ops.push(ops[1]);
        assert!(Schedule::new([2, 1, 2], &ops).is_err());
    }
}
