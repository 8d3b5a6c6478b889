//! Error and alarm numbers in plain words, one table a dialect.

/// A number and what it means.
pub(super) type Code = (u32, &'static str);

pub(super) fn find(table: &[Code], code: u32) -> Option<&'static str> {
    table.iter().find(|(c, _)| *c == code).map(|(_, what)| *what)
}

/// grbl 1.1; grblHAL keeps these.
pub(super) const GRBL_ERRORS: &[Code] = &[
    (1, "a word does not begin with a letter"),
    (2, "a number is missing or malformed"),
    (3, "no such $ command"),
    (4, "a value that must be positive is negative"),
    (5, "homing is switched off in the settings"),
    (6, "a step pulse must last at least 3 µs"),
    (7, "the settings could not be read and were reset to defaults"),
    (8, "this $ command is taken only when idle"),
    (9, "locked out: in alarm or jogging"),
    (10, "soft limits need homing to be switched on"),
    (11, "the line is longer than the controller takes"),
    (12, "the step rate is more than the controller can make"),
    (13, "the safety door is open"),
    (14, "the start-up line or build information is too long"),
    (15, "the jog goes beyond the travel"),
    (16, "the jog command is malformed"),
    (17, "laser mode needs a spindle with variable speed"),
    (20, "a code the controller does not know"),
    (21, "two codes of the same group in one block"),
    (22, "no feed is set"),
    (23, "the value must be a whole number"),
    (24, "two codes in one block both need the axis words"),
    (25, "a word stands twice in one block"),
    (26, "the code needs axis words and has none"),
    (27, "the line number is out of range"),
    (28, "the code lacks a value word"),
    (29, "this work coordinate system does not exist"),
    (30, "G53 goes with G0 and G1 only"),
    (31, "axis words stand without a code that uses them"),
    (32, "an arc has no end point in its plane"),
    (33, "the motion's target is invalid"),
    (34, "the arc's radius does not fit its end point"),
    (35, "an arc lacks its centre words in the plane"),
    (36, "words that no code uses"),
    (37, "G43.1 acts on the tool axis only"),
    (38, "the tool number is too large"),
];

/// What grblHAL adds.
pub(super) const GRBLHAL_ERRORS: &[Code] = &[
    (39, "the value is out of range"),
    (40, "the command is not allowed while a tool change is pending"),
    (41, "the spindle is not running as the motion needs"),
    (42, "the plane does not fit the cycle"),
    (43, "the feed exceeds what the motion allows"),
    (44, "motion while the machine must be homed first"),
    (45, "the spindle is not one the code can use"),
    (46, "the machine must be homed first"),
    (47, "a reply was too long"),
    (48, "this canned cycle needs a retract position"),
    (49, "self-test failed"),
    (50, "emergency stop is active"),
    (51, "the motor drivers report a fault"),
    (52, "the setting's value is out of range"),
    (53, "the setting is switched off"),
    (54, "the tool's offset is not known"),
    (60, "the file system is not mounted"),
    (61, "the file cannot be read"),
    (62, "the directory cannot be read"),
    (63, "the file is empty"),
    (70, "Bluetooth could not be started"),
    (71, "no such operation in an expression"),
    (72, "a division by zero in an expression"),
    (73, "an argument of an expression is out of range"),
    (74, "an argument of an expression is missing"),
    (75, "the expression is malformed"),
    (76, "the expression opens more brackets than it closes"),
    (79, "the flow statement cannot be run here"),
];

/// Alarms grbl and grblHAL agree on.
pub(super) const ALARMS: &[Code] = &[
    (1, "a hard limit was hit; the position is likely lost"),
    (2, "a motion would have left the travel; the position is kept"),
    (3, "reset while moving; steps are likely lost"),
    (4, "the probe was not in the expected state before probing"),
    (5, "the probe touched nothing within its travel"),
    (6, "homing: reset while homing"),
    (7, "homing: the safety door was opened"),
    (8, "homing: the switch could not be pulled off"),
    (9, "homing: the switch was not found"),
];

pub(super) const GRBL_ALARMS: &[Code] =
    &[(10, "homing: the second switch of a dual-axis gantry was not found in time")];

pub(super) const GRBLHAL_ALARMS: &[Code] = &[
    (10, "emergency stop is active; release it, then reset"),
    (11, "the machine must be homed first"),
    (12, "a limit switch is engaged; move off it"),
    (13, "probe protection was triggered"),
    (14, "the spindle did not answer or did not reach its speed"),
    (15, "homing: the second switch of an axis was not found in time"),
    (16, "power-on self-test failed"),
    (17, "a motor driver reports a fault"),
    (18, "homing is not set up"),
];

/// G codes every dialect has, in tenths.
const COMMON_G: &[u32] = &[0, 10, 20, 30, 40, 170, 180, 190, 200, 210, 280, 900, 910, 920];

/// grbl 1.1.
const GRBL_G: &[u32] = &[
    100, 281, 300, 301, 382, 383, 384, 385, 400, 431, 490, 530, 540, 550, 560, 570, 580, 590, 610,
    800, 911, 921, 930, 940,
];

const GRBLHAL_G: &[u32] = &[
    50, 51, 70, 80, 330, 430, 432, 500, 510, 591, 592, 593, 611, 730, 760, 810, 820, 830, 850, 860,
    890, 901, 922, 923, 950, 960, 970, 980, 990,
];

/// Marlin and RepRapFirmware, as far as programs without an E axis use them.
const MARLIN_G: &[u32] =
    &[50, 110, 120, 290, 300, 382, 383, 400, 530, 540, 550, 560, 570, 580, 590, 800];

const RRF_G: &[u32] = &[100, 300, 382, 400, 530, 540, 550, 560, 570, 580, 590, 930, 940];

const COMMON_M: &[u32] = &[0, 10, 20, 30, 40, 50, 70, 80, 90, 300];

const GRBLHAL_M: &[u32] =
    &[60, 480, 490, 500, 510, 530, 560, 600, 610, 620, 630, 640, 650, 660, 670, 680];

/// Moves, waits, fans, lights and what is read back; nothing that writes memory or stops.
const MARLIN_M: &[u32] = &[
    60, 170, 180, 420, 820, 830, 840, 1060, 1070, 1140, 1150, 1170, 1180, 2000, 2010, 2030, 2040,
    2200, 2210, 3000, 4000,
];

pub(super) fn knows_g(dialect: super::Dialect, code: u32) -> bool {
    use super::Dialect::{Grbl, GrblHal, Marlin, Plain, Rrf};
    let more: &[&[u32]] = match dialect {
        Grbl => &[GRBL_G],
        GrblHal => &[GRBL_G, GRBLHAL_G],
        Marlin => &[MARLIN_G],
        Rrf => &[RRF_G],
        Plain => return false,
    };
    COMMON_G.contains(&code) || more.iter().any(|t| t.contains(&code))
}

pub(super) fn knows_m(dialect: super::Dialect, code: u32) -> bool {
    use super::Dialect::{Grbl, GrblHal, Marlin, Plain, Rrf};
    let more: &[u32] = match dialect {
        Grbl => &[],
        GrblHal => GRBLHAL_M,
        // M114 asks where the tool is, which the sender itself does to know that motion is over.
        Marlin | Rrf if code == 1140 => return false,
        Marlin | Rrf => MARLIN_M,
        Plain => return false,
    };
    COMMON_M.contains(&code) || more.contains(&code)
}
