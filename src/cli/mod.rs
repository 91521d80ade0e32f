//! Words in, words out: arguments, progress, exit codes, one file per command. No algorithms.
//!
//! A command `name` is a file with `NameArguments` (clap) and `run(NameArguments, &Terminal) -> Result<()>`. To add
//! one: a `mod` line and a line in `commands!` below.

mod ablate;
mod all_cases;
mod check;
mod compare;
mod comparison;
mod completions;
mod ct_loop;
mod doctor;
mod evaluate;
mod explain;
mod export;
mod gate;
mod import;
mod import_case;
mod import_ct;
mod import_file;
mod import_mesh;
mod import_motion;
mod import_tree;
mod light_bias;
mod list;
mod man;
mod merge;
mod pareto;
mod picture_statistics;
mod render;
mod run;
mod selection;
mod simulate;
mod simulate_ct;
mod slurm;
mod splat;
mod splat_gradients;
mod splat_output;
mod stopped;
mod stress;
mod terminal;
mod track;
mod watch;

use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use crate::base::range::THREADS;
use crate::base::{Error, Progress, Result};
use crate::bench::environment;
pub use terminal::Terminal;

/// Makes the subcommand enum and its dispatch from lines `Variant => file::Arguments`. What stands after the
/// semicolon is handed the whole command line, too.
macro_rules! commands {
    (
        $($(#[$help:meta])* $variant:ident => $file:ident::$arguments:ident,)+
        ;
        $($(#[$line_help:meta])* $line_variant:ident => $line_file:ident::$line_arguments:ident,)+
    ) => {
        #[derive(Subcommand)]
        enum Command {
            $($(#[$help])* $variant($file::$arguments),)+
            $($(#[$line_help])* $line_variant($line_file::$line_arguments),)+
        }

        impl Command {
            fn run(self, terminal: &Terminal) -> Result<()> {
                match self {
                    $(Command::$variant(arguments) => $file::run(arguments, terminal),)+
                    $(Command::$line_variant(arguments) => $line_file::run(arguments, Line::command(), terminal),)+
                }
            }
        }
    };
}

commands! {
    /// The main job: film, reconstruct, score and report all cases; resumes by default
    AllCases => all_cases::AllCasesArguments,
    /// One cell: one case x one method x one seed
    Run => run::RunArguments,
    /// Cases, methods, metrics, and the cells of a plan
    List => list::ListArguments,
    /// What is installed, which instruction set, which library versions
    Doctor => doctor::DoctorArguments,
    /// The main job as a Slurm job array: scripts, and what is left to do
    Slurm => slurm::SlurmArguments,
    /// Turns a user's anatomy or a measured motion into a case
    Import => import::ImportArguments,
    /// Follows a film, a folder or a pipe of pictures as they come: one line of JSON a frame
    Track => track::TrackArguments,
    /// Films cases into sequence folders
    Simulate => simulate::SimulateArguments,
    /// Scans cases: two CT volumes each, with the truth beside them
    SimulateCt => simulate_ct::SimulateCtArguments,
    /// Writes a film in the layout of another program: COLMAP, nerfstudio, EndoNeRF, C3VD, TUM, glTF
    Export => export::ExportArguments,
    /// Scores the predictions of any program against one film or many
    Evaluate => evaluate::EvaluateArguments,
    /// Says in one sentence what is wrong with a folder of predictions, or with a sequence
    Check => check::CheckArguments,
    /// Passes or fails a run: limits, and losses against a baseline
    Gate => gate::GateArguments,
    /// Two runs side by side, with intervals
    Compare => compare::CompareArguments,
    /// Several runs, or scores of a third party, as one report
    Merge => merge::MergeArguments,
    /// What each part of a method, and each property of a film, is worth
    Ablate => ablate::AblateArguments,
    /// What a metric is
    Explain => explain::ExplainArguments,
    /// Measures cost against error of many settings, and draws the front
    Pareto => pareto::ParetoArguments,
    /// Compares the light of films with path tracing, frame by frame
    LightBias => light_bias::LightBiasArguments,
    /// Scans cases, imports the scans, and measures what is lost on the way
    CtLoop => ct_loop::CtLoopArguments,
    /// How far pictures look from real bronchoscopy, by their statistics
    PictureStatistics => picture_statistics::PictureStatisticsArguments,
    /// Path-trace one scene file: linear EXR, depth EXR, timing JSON
    Render => render::RenderArguments,
    /// Rasterise a 3DGS .ply: images, depth, alpha, timing; gradients of a weighted sum
    Splat => splat::SplatArguments,
    /// The numerical-stability table
    Stress => stress::StressArguments,
    ;
    /// Completions of commands and options for bash, zsh, fish and others
    Completions => completions::CompletionsArguments,
    /// Manual pages
    Man => man::ManArguments,
}

/// How accurate is a method that reconstructs a breathing airway from bronchoscopy video, and what does it cost?
#[derive(Parser)]
#[command(name = "respire-bench", version, propagate_version = true, max_term_width = 110)]
#[command(after_help = "Exit codes: 0 ok, 1 a cell failed, 2 usage, 3 regression, 4 input/output, 5 environment, \
    130 interrupted.\nExample: respire-bench all-cases --profile smoke")]
struct Line {
    /// Threads to use; 0 takes every core. Results do not depend on it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", help_heading = "Global options",
        value_parser = THREADS.parser::<usize>())]
    threads: usize,
    /// Begin work that is estimated to take more than half an hour (a day, where it can be resumed), or more than half
    /// of the memory that is left
    #[arg(long, global = true, help_heading = "Global options")]
    yes: bool,
    #[command(subcommand)]
    command: Command,
}

/// Entry point of the binary: reads the command line, runs the command, maps the outcome to the exit code.
pub fn main() -> ExitCode {
    // First of all: a signal in the first instants ends in order, too.
    let mut terminal = match Terminal::new() {
        Ok(terminal) => terminal,
        Err(error) => return refuse(&error),
    };
    environment::report_file_size_limit();
    let line = match Line::try_parse() {
        Ok(line) => line,
        Err(refused) => {
            // Help and version are not errors; neither is a reader that has gone away.
            return match refused.print() {
                Err(e) if !refused.use_stderr() && e.kind() != std::io::ErrorKind::BrokenPipe => {
                    refuse(&Error::io("writing", Path::new("standard output"), e))
                }
                _ => ExitCode::from(refused.exit_code() as u8),
            };
        }
    };
    if line.yes {
        terminal.give_consent();
    }
    match start(line, &terminal).and_then(|()| terminal.output()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => refuse(&error),
    }
}

fn refuse(error: &Error) -> ExitCode {
    terminal::complain(format_args!("error: {error}"));
    ExitCode::from(error.kind().exit_code())
}

fn start(line: Line, terminal: &Terminal) -> Result<()> {
    check_threads_of_environment()?;
    rayon::ThreadPoolBuilder::new()
        .num_threads(line.threads)
        .build_global()
        .map_err(|e| Error::usage(format!("cannot start {} threads: {e}", line.threads)))?;
    terminal.proceed()?;
    let outcome = line.command.run(terminal);
    terminal.finish();
    outcome
}

/// Without `--threads`, rayon reads the number of threads from the environment; it starts as many as it is told.
fn check_threads_of_environment() -> Result<()> {
    const NAME: &str = "RAYON_NUM_THREADS";
    let Ok(word) = std::env::var(NAME) else { return Ok(()) };
    let refused = |sentence| Error::usage(sentence).element(NAME);
    THREADS.parser::<usize>()(&word).map(|_| ()).map_err(refused)
}

#[cfg(test)]
mod tests {
    use std::any::TypeId;

    use clap::CommandFactory;

    /// Value names of options that are numbers.
    const NUMBER_NAMES: [&str; 9] = ["N", "N,..", "PX", "MM", "DEG", "PHASE", "R", "R,..", "GENERATION"];

    /// Clap finds duplicate and contradictory options only when a command is built.
    #[test]
    fn the_command_line_is_consistent_and_every_command_shows_an_example() {
        let line = super::Line::command();
        line.clone().debug_assert();
        for command in line.get_subcommands() {
            let help = command.get_after_help().map(|h| h.to_string()).unwrap_or_default();
            assert!(help.contains("respire-bench"), "`{} --help` shows no example", command.get_name());
        }
    }

    /// Words of an example as a shell would hand them over, up to what is the shell's own.
    fn words(example: &str) -> Vec<String> {
        let quoted = |(k, part): (usize, &str)| if k % 2 == 1 { part.replace(' ', "\u{a0}") } else { part.to_owned() };
        let joined: String = example.split('"').enumerate().map(quoted).collect();
        let words = joined.split(' ').filter(|word| !word.is_empty());
        words.take_while(|word| !["#", ">", "|", "&&"].contains(word)).map(|word| word.replace('\u{a0}', " ")).collect()
    }

    /// `tests/all/examples.rs` runs those that take seconds; here all of them are understood.
    #[test]
    fn every_example_of_the_help_is_a_command_line() {
        use clap::Parser;

        let (mut found, mut commands) = (0, vec![super::Line::command()]);
        while let Some(command) = commands.pop() {
            let help = command.get_after_help().map(|help| help.to_string()).unwrap_or_default();
            for line in help.lines() {
                let line = line.trim_start().trim_start_matches("Example").trim_start_matches(['s', ':', ' ']);
                if line.starts_with("respire-bench ") {
                    found += 1;
                    let parsed = super::Line::try_parse_from(words(line));
                    assert!(parsed.is_ok(), "{}: {line}: {}", command.get_name(), parsed.err().unwrap());
                }
            }
            commands.extend(command.get_subcommands().cloned());
        }
        assert!(found >= 30, "{found} examples were looked at");
    }

    /// Numbers have a value name that says so, by which `tests/all/ranges.rs` finds every one of them.
    #[test]
    fn options_that_are_numbers_say_so() {
        let numbers = [TypeId::of::<u32>(), TypeId::of::<u64>(), TypeId::of::<usize>(), TypeId::of::<f64>()];
        let mut found = 0;
        let mut commands = vec![super::Line::command()];
        while let Some(command) = commands.pop() {
            for argument in command.get_arguments() {
                let named = argument.get_value_names().unwrap_or_default();
                let is_number = numbers.iter().any(|number| argument.get_value_parser().type_id() == *number);
                let says_so = named.iter().any(|name| NUMBER_NAMES.contains(&name.as_str()));
                assert_eq!(is_number, says_so, "{} {} {named:?}", command.get_name(), argument.get_id());
                found += usize::from(is_number);
            }
            commands.extend(command.get_subcommands().cloned());
        }
        assert!(found >= 20, "{found} numbers were looked at");
    }
}
