//! `respire-bench`: see `respire-bench --help`.

fn main() -> std::process::ExitCode {
    respire_bench::cli::main()
}
