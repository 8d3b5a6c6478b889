use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Where a long computation says how far it is. Implementations must be cheap: kernels call them
/// once a slice or once a direction, never once a voxel.
pub trait Progress: Send + Sync {
    /// A stage begins; `total` counts its units of work (0 when unknown).
    fn begin(&self, stage: &str, total: u64);
    /// `n` more units of the current stage are done.
    fn advance(&self, n: u64);
    /// The current stage is over.
    fn end(&self);
}

/// Says nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
}

/// The run was cancelled by the user.
#[derive(Debug, thiserror::Error, PartialEq, Eq, Clone, Copy)]
#[error("interrupted")]
pub struct Cancelled;

/// Budget, cancel and progress, passed to everything that may run long.
#[derive(Clone)]
pub struct Ctx {
    cancel: Arc<AtomicBool>,
    deadline: Option<Instant>,
    progress: Arc<dyn Progress>,
    pub seed: u64,
}

impl Ctx {
    pub fn new(
        cancel: Arc<AtomicBool>,
        deadline: Option<Instant>,
        progress: Arc<dyn Progress>,
        seed: u64,
    ) -> Self {
        Ctx { cancel, deadline, progress, seed }
    }

    /// No budget, no progress, seed 0: for tests and library callers that want none.
    pub fn quiet() -> Self {
        Ctx::new(Arc::new(AtomicBool::new(false)), None, Arc::new(Silent), 0)
    }

    /// The same for work beside a stage that shows its progress.
    pub fn without_progress(&self) -> Self {
        Ctx { progress: Arc::new(Silent), ..self.clone() }
    }

    /// Err once the user has asked to stop.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
    }

    /// Whether there is a time budget.
    pub fn is_limited(&self) -> bool {
        self.deadline.is_some()
    }

    /// Whether the time budget is used up: a search then returns its best result so far.
    pub fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }

    pub fn begin(&self, stage: &str, total: u64) {
        self.progress.begin(stage, total);
    }

    pub fn advance(&self, n: u64) {
        self.progress.advance(n);
    }

    pub fn end(&self) {
        self.progress.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn cancel_reaches_every_clone() {
        let flag = Arc::new(AtomicBool::new(false));
        let ctx = Ctx::new(flag.clone(), None, Arc::new(Silent), 7);
        let other = ctx.clone();
        assert_eq!(other.check(), Ok(()));
        flag.store(true, Ordering::Relaxed);
        assert_eq!(ctx.check(), Err(Cancelled));
        assert_eq!(other.check(), Err(Cancelled));
    }

    #[test]
    fn a_past_deadline_is_out_of_time_and_none_never_is() {
        assert!(!Ctx::quiet().out_of_time());
        let past = Instant::now() - Duration::from_secs(1);
        let ctx = Ctx::new(Arc::new(AtomicBool::new(false)), Some(past), Arc::new(Silent), 0);
        assert!(ctx.out_of_time());
    }
}
