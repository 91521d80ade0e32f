//! `completions`: what a shell needs to complete commands, options and their values.

use clap::Command;
use clap_complete::Shell;

use super::Terminal;
use crate::base::{Error, Result};

/// Arguments of `completions`.
#[derive(clap::Args)]
#[command(
    after_help = "Written to standard output; scripts/package.sh puts those of bash, fish and zsh into its folder.\n\
    Example: respire-bench completions bash > ~/.local/share/bash-completion/completions/respire-bench\n\
    Example: respire-bench completions fish > ~/.config/fish/completions/respire-bench.fish\n\
    Example: respire-bench completions zsh > ~/.zfunc/_respire-bench    # with fpath+=~/.zfunc before compinit"
)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Prints the shell's script for the whole command `line`.
pub fn run(arguments: CompletionsArguments, mut line: Command, terminal: &Terminal) -> Result<()> {
    let name = line.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut line, &name, &mut script);
    let script = String::from_utf8(script).map_err(|e| Error::input(format!("the script is no text: {e}")))?;
    // clap_complete 4.6 names one function of bash in two ways when the program's name has a hyphen, and then completes
    // no option of any command.
    let script = script.replace(&name.replace('-', "__subcmd__"), &name.replace('-', "__"));
    terminal.line(script.trim_end());
    Ok(())
}
