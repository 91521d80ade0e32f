//! A plan as a Slurm job array: shell scripts, as text. Tasks share the cache (`claim.rs`), so that a film which several
//! tasks need is made by one of them, and a task that is run again does only what is missing.

use std::fmt::Write;

/// Most tasks of an array: Slurm's own default limit (`MaxArraySize` 1001) leaves this many numbers from 1 on.
pub const MOST_TASKS: usize = 1000;
/// How much longer than expected a task may take before Slurm ends it, and minutes on top of that.
const TIME_FACTOR: f64 = 3.0;
const TIME_MINUTES: f64 = 10.0;
/// How much more memory than expected a task may take, and MiB on top of that.
const MEMORY_FACTOR: f64 = 1.5;
const MEMORY_MIB: f64 = 512.0;

/// What a job array is made of.
#[derive(Clone, Debug)]
pub struct ArrayJob {
    /// The program, with its path.
    pub program: String,
    /// Words that every task and the report have in common, from `all-cases` on.
    pub common: Vec<String>,
    /// Words of each piece of work.
    pub work: Vec<Vec<String>>,
    /// Words of all of it, for the report.
    pub everything: Vec<String>,
    /// The folder from which the words of `everything` name files.
    pub started_in: String,
    /// Folder of the scripts and of what the tasks print, an absolute path.
    pub folder: String,
    /// Processors of a task.
    pub processors: usize,
    /// Most tasks at a time.
    pub at_once: usize,
    /// What one piece of work is expected to take.
    pub cost: WorkCost,
    /// What the report is expected to take.
    pub report_cost: WorkCost,
}

/// Time and memory of one piece of work, the largest of all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkCost {
    /// CPU seconds.
    pub cpu_s: f64,
    /// Memory in MiB.
    pub memory_mib: f64,
}

impl WorkCost {
    /// Room for either of two.
    pub fn or(self, other: WorkCost) -> WorkCost {
        WorkCost { cpu_s: self.cpu_s.max(other.cpu_s), memory_mib: self.memory_mib.max(other.memory_mib) }
    }

    /// One after the other.
    pub fn then(self, next: WorkCost) -> WorkCost {
        WorkCost { cpu_s: self.cpu_s + next.cpu_s, memory_mib: self.memory_mib.max(next.memory_mib) }
    }

    /// The lines that ask Slurm for it, on some processors, with room to spare.
    fn requests(self, processors: usize) -> String {
        let minutes = self.cpu_s / processors as f64 / 60.0 * TIME_FACTOR + TIME_MINUTES;
        let memory_mib = self.memory_mib * MEMORY_FACTOR + MEMORY_MIB;
        format!(
            "#SBATCH --cpus-per-task={processors}\n#SBATCH --mem={}M\n#SBATCH --time={}\n",
            memory_mib.ceil(),
            minutes.ceil()
        )
    }
}

impl ArrayJob {
    /// Pieces of work that one task does, so that there are not too many tasks.
    pub fn pieces_per_task(&self) -> usize {
        self.work.len().div_ceil(MOST_TASKS).max(1)
    }

    /// Tasks of the array.
    pub fn tasks(&self) -> usize {
        self.work.len().div_ceil(self.pieces_per_task())
    }

    /// `work.txt`: a line of quoted words for each piece of work.
    pub fn work_file(&self) -> String {
        self.work.iter().map(|words| quoted(words) + "\n").collect()
    }

    /// `task.sh`: the array's script.
    pub fn task_script(&self) -> String {
        let pieces = self.pieces_per_task();
        let cost = WorkCost { cpu_s: self.cost.cpu_s * pieces as f64, ..self.cost };
        let mut text = String::from("#!/bin/bash\n");
        let _ = writeln!(text, "#SBATCH --job-name=respire-bench");
        let _ = writeln!(text, "#SBATCH --array=1-{}%{}", self.tasks(), self.at_once);
        text += &cost.requests(self.processors);
        let _ = writeln!(text, "#SBATCH --output={}", quote(&format!("{}/task-%a.log", self.log_folder())));
        let _ = writeln!(text, "# Each task does {pieces} of the lines of work.txt; what is finished is skipped.");
        let work_file = quote(&format!("{}/work.txt", self.folder));
        let _ = writeln!(text, "failed=0 lines=0");
        let _ = writeln!(text, "first=$(((SLURM_ARRAY_TASK_ID - 1) * {pieces} + 1))");
        let _ = writeln!(text, "while read -r line; do");
        let _ = writeln!(text, "  lines=$((lines + 1)) words=()");
        let _ = writeln!(text, "  eval \"words=($line)\" || {{ failed=4; continue; }}");
        let _ = writeln!(
            text,
            "  {} --threads {} --cells-only \"${{words[@]}}\" </dev/null || failed=$?",
            self.command(),
            self.processors
        );
        let _ = writeln!(text, "done < <(sed -n \"$first,$((first + {}))p\" {work_file})", pieces - 1);
        let _ = writeln!(text, "if [ $lines = 0 ]; then");
        let _ = writeln!(text, "  echo 'task: no line for this task in' {work_file}', which every node must see' >&2");
        let _ = writeln!(text, "  exit 4");
        let _ = writeln!(text, "fi");
        let _ = writeln!(text, "exit $failed");
        text
    }

    /// `report.sh`: the job that writes the report when all tasks have ended, and names what is missing.
    pub fn report_script(&self) -> String {
        let mut text = String::from("#!/bin/bash\n");
        let _ = writeln!(text, "#SBATCH --job-name=respire-bench-report");
        text += &self.report_cost.requests(self.processors);
        let _ = writeln!(text, "#SBATCH --output={}", quote(&format!("{}/report.log", self.log_folder())));
        let all = quoted(&self.everything);
        let _ = writeln!(text, "# Where case files of the profile are looked for.");
        let _ = writeln!(text, "cd {}", quote(&self.started_in));
        let _ = writeln!(text, "exec {} --threads {} --report-only {all}", self.command(), self.processors);
        text
    }

    /// `submit.sh`: hands both to Slurm.
    pub fn submit_script(&self) -> String {
        let folder = quote(&self.folder);
        format!(
            "#!/bin/bash\nset -euo pipefail\ntasks=$(sbatch --parsable {folder}/task.sh)\n\
             report=$(sbatch --parsable --dependency=afterany:\"${{tasks%%;*}}\" {folder}/report.sh)\n\
             echo \"tasks: job $tasks, report: job $report\"\n"
        )
    }

    /// What hands the array to Slurm.
    pub fn submit_command(&self) -> String {
        format!("bash {}", quote(&format!("{}/submit.sh", self.folder)))
    }

    /// The folder as Slurm wants it in the name of a log, where `%` begins a pattern.
    fn log_folder(&self) -> String {
        self.folder.replace('%', "%%")
    }

    fn command(&self) -> String {
        format!("{} {}", quote(&self.program), quoted(&self.common))
    }
}

/// Words for a shell.
fn quoted(words: &[String]) -> String {
    words.iter().map(|word| quote(word)).collect::<Vec<_>>().join(" ")
}

/// A word for bash, on one line.
fn quote(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=:+%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    if !word.contains(|c: char| c.is_ascii_control()) {
        return format!("'{}'", word.replace('\'', r"'\''"));
    }
    let escaped = |c: char| match c {
        '\\' | '\'' => format!("\\{c}"),
        c if c.is_ascii_control() => format!("\\{:03o}", u32::from(c)),
        c => c.to_string(),
    };
    format!("$'{}'", word.chars().map(escaped).collect::<String>())
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    fn job(pieces: usize, folder: &str) -> ArrayJob {
        let words = |line: &[&str]| line.iter().map(|word| (*word).to_owned()).collect::<Vec<String>>();
        ArrayJob {
            program: "echo".into(),
            common: words(&["all-cases", "--cache", "a b/it's"]),
            work: (0..pieces).map(|k| words(&["--cases", &format!("case {k}")])).collect(),
            everything: words(&["--cases", "a,b"]),
            started_in: "/tmp".into(),
            folder: folder.into(),
            processors: 4,
            at_once: 20,
            cost: WorkCost { cpu_s: 2400.0, memory_mib: 1000.0 },
            report_cost: WorkCost { cpu_s: 240.0, memory_mib: 100.0 },
        }
    }

    #[test]
    fn a_task_runs_its_lines_with_their_words_whole() {
        let folder = tempfile::tempdir().unwrap();
        for (pieces, tasks, at) in [(3, 3, 2), (2500, 834, 834)] {
            let job = job(pieces, folder.path().to_str().unwrap());
            assert_eq!(job.tasks(), tasks);
            std::fs::write(folder.path().join("work.txt"), job.work_file()).unwrap();
            std::fs::write(folder.path().join("task.sh"), job.task_script()).unwrap();
            let run = |task: usize| {
                let mut bash = Command::new("bash");
                bash.arg(folder.path().join("task.sh")).env("SLURM_ARRAY_TASK_ID", task.to_string());
                String::from_utf8(bash.output().unwrap().stdout).unwrap()
            };
            let said = run(at);
            let last =
                format!("all-cases --cache a b/it's --threads 4 --cells-only --cases case {}\n", at.min(2500) - 1);
            if pieces == 3 {
                assert_eq!(said, last);
            } else {
                // 833 tasks of three lines leave one.
                assert_eq!(said.lines().count(), 1);
                assert!(said.ends_with("case 2499\n"), "{said}");
                assert_eq!(run(1).lines().count(), 3);
            }
        }
    }

    #[test]
    fn a_word_of_several_lines_stays_one_word() {
        let folder = tempfile::tempdir().unwrap();
        let mut job = job(2, folder.path().to_str().unwrap());
        job.work[1][1] = "a\nb\tit's \\n".into();
        std::fs::write(folder.path().join("work.txt"), job.work_file()).unwrap();
        std::fs::write(folder.path().join("task.sh"), job.task_script()).unwrap();
        let run = |task: usize| {
            let mut bash = Command::new("bash");
            bash.arg(folder.path().join("task.sh")).env("SLURM_ARRAY_TASK_ID", task.to_string());
            let done = bash.output().unwrap();
            (String::from_utf8(done.stdout).unwrap(), done.status.code())
        };
        let (said, code) = run(2);
        assert!(said.ends_with("--cases a\nb\tit's \\n\n") && code == Some(0), "{said}");
        assert_eq!(run(3), (String::new(), Some(4)), "there is no such line");
        std::fs::remove_file(folder.path().join("work.txt")).unwrap();
        assert_eq!(run(1), (String::new(), Some(4)), "a node that does not see the scripts");
        assert!(job.submit_command().starts_with("bash /"));
    }

    #[test]
    fn room_is_asked_for_by_cost() {
        let script = job(2500, "/logs").task_script();
        // Three pieces of ten minutes on four processors, three times as long, and ten minutes.
        for line in ["--array=1-834%20", "--cpus-per-task=4", "--mem=2012M", "--time=100", "--output=/logs/task-%a.log"]
        {
            assert!(script.contains(&format!("#SBATCH {line}\n")), "{line} is not in {script}");
        }
        let odd = job(3, "/my logs/100 %");
        assert!(odd.task_script().contains("#SBATCH --output='/my logs/100 %%/task-%a.log'\n"));
        assert!(odd.report_script().contains("#SBATCH --output='/my logs/100 %%/report.log'\n"));
        assert!(odd.report_script().contains("\ncd /tmp\nexec echo all-cases "), "{}", odd.report_script());
        assert!(job(3, "/logs").submit_script().contains("--dependency=afterany:"));
        let report = job(3, "/logs").report_script();
        assert!(report.ends_with("--report-only --cases a,b\n"));
        // A minute on four processors, three times as long, and ten minutes.
        assert!(report.contains("#SBATCH --cpus-per-task=4\n#SBATCH --mem=662M\n#SBATCH --time=13\n"), "{report}");
    }
}
