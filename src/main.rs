//! The `hmplan` command line; everything it computes is in the library.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
