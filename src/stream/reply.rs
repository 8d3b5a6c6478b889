//! Reads what controllers say, one line at a time. No line panics, whatever its bytes.

use super::Dialect;

/// Longest reply that is kept, bytes; longer ones are cut and count as garbled. The longest that
/// controllers send are status reports of six axes, some 200.
const LONGEST_REPLY: usize = 512;

/// Most axes a status may name.
const MOST_AXES: usize = 9;

/// A machine's state as its status report names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    Idle,
    Run,
    /// Sub-state 0 stands still, anything else is still slowing down.
    Hold(u8),
    Jog,
    Alarm,
    Door,
    Check,
    Home,
    Sleep,
    Tool,
}

/// A status report; what it does not say is None.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    pub state: State,
    /// Machine position, mm and degrees, one number an axis.
    pub machine: Option<Vec<f64>>,
    pub work: Option<Vec<f64>>,
    /// work = machine − offset.
    pub offset: Option<Vec<f64>>,
    /// Feed mm/min, spindle 1/min.
    pub feed_speed: Option<(f64, f64)>,
    /// Overrides of feed, rapid, spindle, per cent.
    pub overrides: Option<[u32; 3]>,
    /// Free planner blocks and receive bytes; for show, never for flow.
    pub buffer: Option<(u32, u32)>,
    pub line: Option<u32>,
}

/// One line from a controller.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// A line was taken; some boards name its number or repeat its text.
    Ok {
        number: Option<u32>,
        text: Option<String>,
    },
    /// A line was refused.
    Error {
        code: Option<u32>,
        text: String,
    },
    /// A numbered line is to be sent again.
    Resend(Option<u32>),
    /// Part of the talk about a damaged line, before the request to send it again.
    Damaged,
    Alarm(Option<u32>),
    Banner(String),
    Status(Box<Status>),
    /// From the build information: blocks of the planner, where told, and bytes of the receive
    /// buffer.
    Build {
        blocks: Option<usize>,
        bytes: usize,
    },
    /// The parser's state, word by word: the answer to `$G`.
    Parser(String),
    /// The controller repeats what it read.
    Echo(String),
    /// Alive and not ready yet.
    Busy,
    /// Waits for a person.
    Paused,
    /// Where the tool is: the answer to M114.
    Position(Vec<f64>),
    Unknown(String),
    /// The firmware has given up.
    Fatal(String),
    Info(String),
    Empty,
    Garbled,
}

/// Cuts a stream of bytes into lines.
#[derive(Debug, Default)]
pub struct Lines {
    part: Vec<u8>,
    too_long: bool,
}

impl Lines {
    /// Adds bytes; calls `f` with every finished line, None for one that cannot be text.
    pub fn push(&mut self, bytes: &[u8], mut f: impl FnMut(Option<&str>)) {
        for b in bytes {
            match b {
                b'\n' => {
                    let text = std::str::from_utf8(&self.part).ok().map(str::trim);
                    f(text.filter(|_| !self.too_long));
                    self.part.clear();
                    self.too_long = false;
                }
                b'\r' => {}
                _ if self.part.len() < LONGEST_REPLY => self.part.push(*b),
                _ => self.too_long = true,
            }
        }
    }

    /// Forgets an unfinished line.
    pub fn clear(&mut self) {
        self.part.clear();
        self.too_long = false;
    }
}

impl Reply {
    pub fn read(dialect: Dialect, line: Option<&str>) -> Reply {
        let Some(line) = line else { return Reply::Garbled };
        if line.is_empty() {
            return Reply::Empty;
        }
        match dialect {
            // Numbered dialects repeat damaged lines as they are; elsewhere such bytes are damage.
            _ if !dialect.is_numbered() && line.bytes().any(|b| b < 0x20) => Reply::Garbled,
            Dialect::Grbl | Dialect::GrblHal => grbl(line),
            Dialect::Marlin | Dialect::Rrf => marlin(line),
            Dialect::Plain => plain(line),
        }
    }
}

fn ok() -> Reply {
    Reply::Ok { number: None, text: None }
}

fn grbl(line: &str) -> Reply {
    if line == "ok" {
        return ok();
    }
    if let Some(rest) = line.strip_prefix("error:") {
        return Reply::Error { code: rest.trim().parse().ok(), text: line.into() };
    }
    if let Some(rest) = line.strip_prefix("ALARM:") {
        return Reply::Alarm(rest.trim().parse().ok());
    }
    let lower = line.to_ascii_lowercase();
    if lower.starts_with("grbl") {
        return Reply::Banner(line.into());
    }
    if let Some(body) = line.strip_prefix('<') {
        let status = body.strip_suffix('>').and_then(status);
        return status.map_or(Reply::Garbled, |s| Reply::Status(Box::new(s)));
    }
    if let Some(body) = line.strip_prefix('[') {
        let Some(body) = body.strip_suffix(']') else { return Reply::Garbled };
        if let Some(echo) = body.strip_prefix("echo:") {
            return Reply::Echo(echo.trim().into());
        }
        if let Some(opt) = body.strip_prefix("OPT:") {
            let figure = |i| opt.split(',').nth(i).and_then(|b| b.parse().ok());
            let blocks = figure(1);
            return figure(2)
                .map_or(Reply::Info(line.into()), |bytes| Reply::Build { blocks, bytes });
        }
        if let Some(state) = body.strip_prefix("GC:") {
            return Reply::Parser(state.into());
        }
        return Reply::Info(line.into());
    }
    match line.as_bytes()[0] {
        b'$' | b'>' => Reply::Info(line.into()),
        _ => Reply::Garbled,
    }
}

fn status(body: &str) -> Option<Status> {
    let mut fields = body.split('|');
    let mut out = Status {
        state: state(fields.next()?)?,
        machine: None,
        work: None,
        offset: None,
        feed_speed: None,
        overrides: None,
        buffer: None,
        line: None,
    };
    for field in fields {
        let (name, value) = field.split_once(':')?;
        match name {
            "MPos" => out.machine = Some(numbers(value)?),
            "WPos" => out.work = Some(numbers(value)?),
            "WCO" => out.offset = Some(numbers(value)?),
            "F" => out.feed_speed = Some((*numbers(value)?.first()?, 0.0)),
            "FS" => {
                let v = numbers(value)?;
                out.feed_speed = Some((*v.first()?, *v.get(1)?));
            }
            "Ov" => {
                let v: Vec<u32> = value.split(',').map_while(|t| t.parse().ok()).collect();
                out.overrides = Some(v.try_into().ok()?);
            }
            "Bf" => {
                let (a, b) = value.split_once(',')?;
                out.buffer = Some((a.parse().ok()?, b.parse().ok()?));
            }
            "Ln" => out.line = Some(value.parse().ok()?),
            // Pins, accessories and what is yet to come.
            _ => {}
        }
    }
    Some(out)
}

fn state(word: &str) -> Option<State> {
    let (name, sub) = word.split_once(':').map_or((word, None), |(n, s)| (n, Some(s)));
    let sub = sub.map(str::parse::<u8>).transpose().ok()?;
    Some(match name {
        "Idle" => State::Idle,
        "Run" => State::Run,
        "Hold" => State::Hold(sub.unwrap_or(0)),
        "Jog" => State::Jog,
        "Alarm" => State::Alarm,
        "Door" => State::Door,
        "Check" => State::Check,
        "Home" => State::Home,
        "Sleep" => State::Sleep,
        "Tool" => State::Tool,
        _ => return None,
    })
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    let all: Option<Vec<f64>> = text.split(',').map(number).collect();
    all.filter(|v| v.len() <= MOST_AXES)
}

fn number(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|v| v.is_finite())
}

fn marlin(line: &str) -> Reply {
    let lower = line.to_ascii_lowercase();
    if let Some(rest) = lower.strip_prefix("ok")
        && (rest.is_empty() || rest.starts_with([' ', ':']))
    {
        let number = rest.split_whitespace().find_map(|w| w.strip_prefix('n')?.parse().ok());
        return Reply::Ok { number, text: None };
    }
    if let Some(rest) = lower.strip_prefix("resend").or_else(|| lower.strip_prefix("rs")) {
        let digits = rest.trim_start_matches([':', ' ', 'n']);
        return Reply::Resend(digits.split_whitespace().next().and_then(|d| d.parse().ok()));
    }
    if lower.starts_with("error:") || lower.starts_with("!!") {
        let link = ["checksum", "line number", "last line"].iter().any(|w| lower.contains(w));
        return if link { Reply::Damaged } else { Reply::Fatal(line.into()) };
    }
    if lower.starts_with("busy:") || lower.starts_with("echo:busy") || lower == "wait" {
        return if lower.contains("paused") { Reply::Paused } else { Reply::Busy };
    }
    if let Some(rest) = lower.strip_prefix("echo:unknown command:") {
        let at = line.len() - rest.len();
        return Reply::Unknown(line[at..].trim().trim_matches('"').into());
    }
    if lower == "start" || lower.starts_with("reprapfirmware") {
        return Reply::Banner(line.into());
    }
    if lower.starts_with("x:")
        && let Some(position) = marlin_position(&lower)
    {
        return Reply::Position(position);
    }
    Reply::Info(line.into())
}

/// `X:1.00 Y:2.00 Z:3.00 E:0.00 Count X:80 …`, the axes alone.
fn marlin_position(lower: &str) -> Option<Vec<f64>> {
    let before = lower.split("count").next()?;
    let axes = before.split_whitespace().filter(|w| !w.starts_with('e'));
    axes.map(|w| number(w.split_once(':')?.1))
        .collect::<Option<Vec<f64>>>()
        .filter(|v| v.len() >= 3)
}

fn plain(line: &str) -> Reply {
    let lower = line.to_ascii_lowercase();
    if lower == "ok" {
        return ok();
    }
    if lower.starts_with("ok ") {
        return Reply::Ok { number: None, text: Some(line[3..].trim().into()) };
    }
    if let Some(rest) = lower.strip_prefix("error") {
        let code = rest.trim_start_matches([':', ' ']).split_whitespace().next();
        return Reply::Error { code: code.and_then(|c| c.parse().ok()), text: line.into() };
    }
    if lower == "busy" || lower.starts_with("busy:") || lower == "wait" {
        return Reply::Busy;
    }
    if lower == "ready" || lower == "start" || lower.starts_with("ready ") {
        return Reply::Banner(line.into());
    }
    Reply::Info(line.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hal(line: &str) -> Reply {
        Reply::read(Dialect::GrblHal, Some(line))
    }

    #[test]
    fn a_status_has_as_many_coordinates_as_axes_and_fields_in_any_order() {
        let Reply::Status(s) = hal(
            "<Hold:1|WCO:1,2,3,0,0|MPos:1.5,-2.000,3.000,90.000,0.000|Bf:15,128|FS:500,8000|Ov:100,50,100>",
        ) else {
            panic!("a status")
        };
        assert_eq!((s.state, s.machine.as_ref().unwrap().len()), (State::Hold(1), 5));
        assert_eq!(s.overrides, Some([100, 50, 100]));
        assert_eq!(s.offset.unwrap(), [1.0, 2.0, 3.0, 0.0, 0.0]);
        assert!(matches!(hal("<Idle>"), Reply::Status(_)));
        for bad in ["<Idel|MPos:0,0,0>", "<Idle|MPos:0,x,0>", "<Idle|MPos:0,0", "<Idle|MPos:nan>"] {
            assert_eq!(hal(bad), Reply::Garbled, "{bad}");
        }
    }

    #[test]
    fn only_ok_and_error_answer_a_line() {
        assert_eq!(hal("ok"), Reply::Ok { number: None, text: None });
        assert!(matches!(hal("error:20"), Reply::Error { code: Some(20), .. }));
        for other in ["[MSG:Check Door]", "$110=500.000", ">G54:ok", "Grbl 1.1h ['$' for help]"] {
            assert!(matches!(hal(other), Reply::Info(_) | Reply::Banner(_)), "{other}");
        }
        assert_eq!(hal("[OPT:V,15,128]"), Reply::Build { blocks: Some(15), bytes: 128 });
        assert_eq!(hal("[GC:G0 G54 M5]"), Reply::Parser("G0 G54 M5".into()));
        assert_eq!(hal("okerror:20"), Reply::Garbled);
        assert_eq!(hal("[echo: G1X1]"), Reply::Echo("G1X1".into()));
    }

    #[test]
    fn numbered_talk() {
        let m = |l: &str| Reply::read(Dialect::Marlin, Some(l));
        assert_eq!(m("Resend: 12"), Reply::Resend(Some(12)));
        assert_eq!(m("rs N12"), Reply::Resend(Some(12)));
        assert_eq!(m("rs 12"), Reply::Resend(Some(12)));
        assert_eq!(m("Resend: 1x"), Reply::Resend(None));
        assert_eq!(m("Error:checksum mismatch, Last Line: 4"), Reply::Damaged);
        assert!(matches!(m("Error:Printer halted. kill() called!"), Reply::Fatal(_)));
        assert_eq!(m("ok N5 P15 B3"), Reply::Ok { number: Some(5), text: None });
        assert_eq!(m("echo:Unknown command: \"M72\""), Reply::Unknown("M72".into()));
        assert_eq!(
            m("X:1.00 Y:2.00 Z:3.00 E:0.00 Count X:80 Y:0 Z:9"),
            Reply::Position(vec![1.0, 2.0, 3.0])
        );
        assert_eq!(m("echo:busy: processing"), Reply::Busy);
    }

    proptest! {
        #[test]
        fn nothing_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut lines = Lines::default();
            for d in Dialect::ALL {
                lines.push(&bytes, |l| { let _ = Reply::read(d, l); });
                lines.push(b"\n", |l| { let _ = Reply::read(d, l); });
            }
        }
    }
}
