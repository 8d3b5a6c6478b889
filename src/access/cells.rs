//! Room for images of heights.
//!
//! A direction takes several images of some megabytes, and asks for as many again a few
//! milliseconds later. Memory that comes fresh from the system costs a page fault for every 4 KiB,
//! together more than a third of the time of a query; so each thread keeps the last few images it
//! gave up and fills these again.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};

/// Images kept by a thread: those of one query on a scene. More hold memory that nobody asks for,
/// fewer fault pages again.
const KEPT: usize = 6;

/// Fewer cells than this are not worth keeping: an allocator has them at hand.
const LEAST_KEPT: usize = 16 * 1024;

thread_local! {
    static SPARE: RefCell<Vec<Vec<f32>>> = const { RefCell::new(Vec::new()) };
}

/// The cells of an image; their memory is used again by the thread that drops them.
#[derive(Default)]
pub struct Cells(Vec<f32>);

impl Cells {
    /// `n` cells of one value.
    pub fn filled(n: usize, value: f32) -> Cells {
        let mut cells = Cells::with_room(n);
        cells.resize(n, value);
        cells
    }

    /// No cells yet, room for `n`. A map that is kept for long takes at most twice what it needs.
    pub fn with_room(n: usize) -> Cells {
        let fits = |room: &Vec<f32>| (n..=2 * n).contains(&room.capacity());
        let spare = SPARE
            .with_borrow_mut(|spare| spare.iter().position(fits).map(|i| spare.swap_remove(i)));
        Cells(spare.unwrap_or_else(|| Vec::with_capacity(n)))
    }
}

impl Deref for Cells {
    type Target = Vec<f32>;
    fn deref(&self) -> &Vec<f32> {
        &self.0
    }
}

impl DerefMut for Cells {
    fn deref_mut(&mut self) -> &mut Vec<f32> {
        &mut self.0
    }
}

impl Drop for Cells {
    fn drop(&mut self) {
        let mut room = std::mem::take(&mut self.0);
        if room.capacity() < LEAST_KEPT {
            return;
        }
        room.clear();
        // A thread that ends has given up its spare images; then these go as well.
        let _ = SPARE.try_with(|spare| {
            let mut spare = spare.borrow_mut();
            if spare.len() == KEPT {
                spare.remove(0);
            }
            spare.push(room);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_were_used_before_are_filled_anew() {
        let mut first = Cells::filled(LEAST_KEPT, 1.0);
        first[7] = 5.0;
        let place = first.as_ptr();
        drop(first);
        let again = Cells::filled(LEAST_KEPT - 1, 2.0);
        assert_eq!(again.as_ptr(), place, "the memory is used again");
        assert!(again.len() == LEAST_KEPT - 1 && again.iter().all(|c| *c == 2.0));
    }

    #[test]
    fn a_thread_keeps_a_few_images_only() {
        drop((0..3 * KEPT).map(|_| Cells::filled(LEAST_KEPT, 0.0)).collect::<Vec<_>>());
        SPARE.with_borrow(|spare| assert_eq!(spare.len(), KEPT));
        // A small image does not hold on to the room of a large one.
        assert!(Cells::filled(LEAST_KEPT / 4, 0.0).capacity() <= LEAST_KEPT / 2);
    }
}
