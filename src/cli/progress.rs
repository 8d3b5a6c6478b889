//! Progress on standard error: bars with the time left on a terminal, log lines otherwise.

use super::args::OutputArgs;
use hmplan::base::{Progress, Silent};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal as _;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What fits the flags and the place standard error goes to.
pub fn fitting(output: &OutputArgs) -> Arc<dyn Progress> {
    if output.quiet {
        Arc::new(Silent)
    } else if output.verbose > 0 {
        Arc::new(Lines::default())
    } else if std::io::stderr().is_terminal() {
        Arc::new(Bars::default())
    } else {
        Arc::new(Silent)
    }
}

/// One bar, that of the innermost stage.
#[derive(Default)]
struct Bars {
    open: Mutex<Vec<ProgressBar>>,
}

/// Redraws of the spinner of a stage of unknown length.
const TICK: Duration = Duration::from_millis(120);

impl Bars {
    fn with<R>(&self, f: impl FnOnce(&mut Vec<ProgressBar>) -> R) -> R {
        f(&mut self.open.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Progress for Bars {
    fn begin(&self, stage: &str, total: u64) {
        let (bar, template) = if total > 0 {
            (ProgressBar::new(total), "{msg:<28} {bar:30} {percent:>3} %  {eta} left")
        } else {
            (ProgressBar::new_spinner(), "{msg:<28} {spinner} {elapsed}")
        };
        bar.set_draw_target(ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(stage.to_string());
        bar.enable_steady_tick(TICK);
        self.with(|open| {
            if let Some(outer) = open.last() {
                outer.disable_steady_tick();
            }
            open.push(bar);
        });
    }

    fn advance(&self, n: u64) {
        self.with(|open| {
            if let Some(bar) = open.last() {
                bar.inc(n);
            }
        });
    }

    fn end(&self) {
        self.with(|open| {
            if let Some(bar) = open.pop() {
                bar.finish_and_clear();
            }
            if let Some(outer) = open.last() {
                outer.enable_steady_tick(TICK);
            }
        });
    }
}

/// A log line at the end of each stage.
#[derive(Default)]
struct Lines {
    open: Mutex<Vec<(String, Instant)>>,
}

impl Progress for Lines {
    fn begin(&self, stage: &str, total: u64) {
        tracing::debug!(total, "{stage} …");
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.push((stage.to_string(), Instant::now()));
    }

    fn advance(&self, _: u64) {}

    fn end(&self) {
        let stage = self.open.lock().unwrap_or_else(PoisonError::into_inner).pop();
        if let Some((stage, began)) = stage {
            tracing::info!("{stage}: {:.2} s", began.elapsed().as_secs_f64());
        }
    }
}
