//! Arcs in the plane across the tool axis, run as short straight moves.

use super::{Gait, Interpreter, Motion};
use crate::base::{DVec2, DVec3};
use crate::gcode::report::Rule;

/// Radii at both ends of an arc may differ by this much, mm: all words are rounded.
const RADIUS_MM: f64 = 0.005;

/// How far the straight moves an arc is run as may leave it, mm.
const CHORD_MM: f64 = 0.001;

/// Fewest straight moves of an arc.
const LEAST_CHORDS: f64 = 2.0;

impl Interpreter<'_> {
    /// Runs an arc: `axes` its end, `center` relative to where it begins, `motion` 2 or 3.
    pub(super) fn arc(
        &mut self,
        axes: [Option<f64>; 3],
        center: [Option<f64>; 2],
        motion: u32,
        filament: Option<f64>,
    ) {
        let (Some(step), Some(tool)) = (self.step(), self.tool()) else { return };
        let gauge = tool.gauge_mm();
        let start = self.tip(step, gauge);
        let ([Some(x), Some(y), Some(_)], Some((mut from, _))) = (self.nose, start) else {
            return self.find(Rule::Modes, "an arc from an unknown position");
        };
        if axes[2].is_some() {
            return self.find(Rule::Syntax, "an arc with Z: helices are not read");
        }
        let begin = DVec2::new(x, y);
        let end = DVec2::new(axes[0].unwrap_or(x), axes[1].unwrap_or(y));
        if center == [None; 2] || end == begin {
            return self.find(Rule::Syntax, "an arc needs an end and its centre by I and J");
        }
        let middle = begin + DVec2::new(center[0].unwrap_or(0.0), center[1].unwrap_or(0.0));
        let (p, q) = (begin - middle, end - middle);
        let radius = p.length();
        if (q.length() - radius).abs() > RADIUS_MM {
            let off = q.length() - radius;
            return self
                .find(Rule::Syntax, format!("the arc's ends lie {off:.4} mm apart in radius"));
        }
        let sense = if motion == 3 { 1.0 } else { -1.0 };
        let turn = (sense * p.perp_dot(q).atan2(p.dot(q))).rem_euclid(std::f64::consts::TAU);
        if turn > std::f64::consts::PI {
            // Never written: it is a short one turned the wrong way.
            return self.find(Rule::Syntax, "an arc of more than half a turn");
        }
        let chord = 2.0 * (1.0 - (CHORD_MM / radius).min(1.0)).acos();
        let n = (turn / chord).ceil().clamp(LEAST_CHORDS, 1e5) as usize;
        self.states(motion, step);
        let feed = self.feed.unwrap_or(0.0);
        let gait = if self.extruding { Gait::Deposit } else { Gait::Feed };
        let mut length = 0.0;
        for k in 1..=n {
            let share = k as f64 / n as f64;
            let at = DVec2::from_angle(sense * turn * share).rotate(p);
            // Between two slightly different radii the arc is a spiral.
            let stretch = 1.0 + share * (q.length() / radius - 1.0);
            let at = if k == n { end } else { middle + at * stretch };
            (self.nose[0], self.nose[1]) = (Some(at.x), Some(at.y));
            if let Some(axes) = self.axes(gauge)
                && let Err(e) = self.machine.kinematics.check_axes(axes, gauge)
            {
                self.find(Rule::Limits, e.to_string());
            }
            let Some((to, _)) = self.tip(step, gauge) else { return };
            length += from.distance(to);
            self.motions.push(Motion { line: self.line, step, gait, from: Some(from), to, feed });
            from = to;
        }
        self.arc_bead(from, filament, length, gait);
    }

    fn arc_bead(&mut self, to: DVec3, filament: Option<f64>, length: f64, gait: Gait) {
        let Some(step) = self.step() else { return };
        if gait == Gait::Deposit {
            self.bead_feed(self.setting.plan.steps[step].direction.dot(to));
        }
        if let Some(e) = filament {
            self.bead_filament(e, length);
        }
    }
}
