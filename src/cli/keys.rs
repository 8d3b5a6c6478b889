//! What a person types while a job runs: single keys on a terminal, words otherwise.

use hmplan::stream::Remote;
use hmplan::stream::core::Command;
use std::io::{self, BufRead as _, IsTerminal as _, Read as _};

/// Puts the terminal back as it was when dropped.
pub struct Keys {
    #[cfg(unix)]
    before: Option<rustix::termios::Termios>,
}

impl Keys {
    /// Begins to listen on standard input.
    pub fn listen(remote: Remote) -> Keys {
        if !io::stdin().is_terminal() {
            std::thread::spawn(move || words(&remote));
            return Keys {
                #[cfg(unix)]
                before: None,
            };
        }
        let keys = Keys {
            #[cfg(unix)]
            before: single_keys(),
        };
        std::thread::spawn(move || {
            for key in io::stdin().lock().bytes().map_while(Result::ok) {
                if let Some(command) = of_key(key) {
                    remote.send(command);
                }
            }
        });
        keys
    }
}

/// Keys arrive one by one and are not shown; signals stay as they are.
#[cfg(unix)]
fn single_keys() -> Option<rustix::termios::Termios> {
    use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
    let before = tcgetattr(io::stdin()).ok()?;
    let mut now = before.clone();
    now.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
    tcsetattr(io::stdin(), OptionalActions::Now, &now).ok()?;
    Some(before)
}

impl Drop for Keys {
    fn drop(&mut self) {
        #[cfg(unix)]
        if let Some(before) = &self.before {
            use rustix::termios::{OptionalActions, tcsetattr};
            // The terminal may be gone; then there is nothing to put back.
            let _ = tcsetattr(io::stdin(), OptionalActions::Now, before);
        }
    }
}

fn of_key(key: u8) -> Option<Command> {
    Some(match key {
        b'h' | b'!' => Command::Hold,
        b'r' | b'~' => Command::Resume,
        b'q' => Command::Stop,
        // Feed override: ten per cent more, less, and back to what is programmed.
        b'+' => Command::Override(0x91),
        b'-' => Command::Override(0x92),
        b'0' => Command::Override(0x90),
        _ => return None,
    })
}

fn words(remote: &Remote) {
    for line in io::stdin().lock().lines().map_while(Result::ok) {
        match line.trim() {
            "hold" => remote.send(Command::Hold),
            "resume" => remote.send(Command::Resume),
            "stop" => remote.send(Command::Stop),
            _ => {}
        }
    }
}
