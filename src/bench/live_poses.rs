//! Times and poses as a tracker sends them while a film goes on: one line of JSON for each frame.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use glam::DAffine3;
use serde::Deserialize;

use crate::base::range::{COORDINATE_MM, TIME_S};
use crate::base::{Error, Result, pose};

/// Most bytes of a line; a pose has some hundred.
const MOST_LINE_BYTES: u64 = 64 << 10;

/// One line.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LivePose {
    /// Seconds since the first frame.
    time_s: f64,
    /// Rows of the matrix from the camera's axes (x right, y down, z forward) to the world's, mm.
    world_from_camera: [[f64; 4]; 4],
}

impl LivePose {
    fn read(line: &[u8]) -> Result<(f64, DAffine3)> {
        let pose: LivePose = serde_json::from_slice(line).map_err(|e| Error::input(format!("is no pose: {e}")))?;
        TIME_S.check(pose.time_s).map_err(|e| Error::input(format!("time_s: {e}")))?;
        let named = |e: Error| Error::input(format!("world_from_camera {e}"));
        Ok((pose.time_s, pose::from_rows(&pose.world_from_camera, COORDINATE_MM).map_err(named)?))
    }
}

/// Lines that come one after the other, from a file or a pipe.
pub struct LivePoses<R> {
    lines: BufReader<R>,
    path: PathBuf,
    /// Lines read.
    count: usize,
    /// Seconds of the last one.
    last_s: Option<f64>,
}

impl LivePoses<File> {
    /// Opens the file or pipe at `path`; opening a pipe waits for who writes into it.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io("opening", path, e))?;
        Ok(Self::new(file, path))
    }
}

impl<R: Read> LivePoses<R> {
    /// Takes lines from `reader`, which errors name as `path`.
    pub fn new(reader: R, path: &Path) -> Self {
        LivePoses { lines: BufReader::new(reader), path: path.to_path_buf(), count: 0, last_s: None }
    }

    /// What errors call it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Time in seconds and pose of the next frame; `None` after the last line. Waits for a line that has not come yet.
    ///
    /// Errors name the line: longer than 64 KiB, no JSON of a time and a rigid motion, a number out of range, a time
    /// that does not come after that of the line before.
    pub fn next_pose(&mut self) -> Result<Option<(f64, DAffine3)>> {
        let mut line = Vec::new();
        let mut bounded = self.lines.by_ref().take(MOST_LINE_BYTES);
        let read = bounded.read_until(b'\n', &mut line).map_err(|e| Error::io("reading", &self.path, e))?;
        if read == 0 {
            return Ok(None);
        }
        self.count += 1;
        let (count, last_s) = (self.count, self.last_s);
        let parsed = match line.last() {
            Some(b'\n') => LivePose::read(&line),
            _ if read as u64 == MOST_LINE_BYTES => {
                Err(Error::input(format!("does not end within {} KiB", MOST_LINE_BYTES >> 10)))
            }
            _ => LivePose::read(&line),
        };
        let pose = parsed.and_then(|(time_s, pose)| match last_s.filter(|last_s| *last_s >= time_s) {
            Some(last_s) => Err(Error::input(format!("time_s: {time_s} does not come after {last_s}"))),
            None => Ok((time_s, pose)),
        });
        let pose = pose.map_err(|e| e.element(format!("line {count}")).at(&self.path))?;
        self.last_s = Some(pose.0);
        Ok(Some(pose))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "{\"time_s\":0.5,\"world_from_camera\":[[1,0,0,4],[0,1,0,5],[0,0,1,6],[0,0,0,1]]}";

    fn poses(text: &str) -> LivePoses<&[u8]> {
        LivePoses::new(text.as_bytes(), Path::new("sensor"))
    }

    #[test]
    fn lines_are_read_one_by_one() {
        let text = format!("{GOOD}\n{}", GOOD.replace("0.5", "0.75"));
        let mut poses = poses(&text);
        let (time_s, pose) = poses.next_pose().unwrap().unwrap();
        assert_eq!((time_s, pose.translation.to_array()), (0.5, [4.0, 5.0, 6.0]));
        assert_eq!(poses.next_pose().unwrap().unwrap().0, 0.75);
        assert!(poses.next_pose().unwrap().is_none());
    }

    #[test]
    fn a_line_that_is_no_pose_is_refused_by_its_number() {
        for (from, to, says) in [
            (GOOD, "", "is no pose"),
            (GOOD, "{}", "is no pose"),
            ("0.5", "1e999", "is no pose"),
            ("0.5", "-1", "time_s: -1 must lie in 0 to 1e7"),
            ("0.5", "1e300", "time_s: 1e300 must lie in 0 to 1e7"),
            ("[[1,", "[[2,", "no rotation"),
            ("[[1,", "[[-1,", "no rotation"),
            ("5],[0", "1e300],[0", "lies too far away"),
            ("[0,0,0,1]", "[4,5,6,1]", "another last row"),
            ("[0,0,0,1]", "[0,0,0,0]", "another last row"),
        ] {
            let said = poses(&format!("{}\n", GOOD.replacen(from, to, 1))).next_pose().unwrap_err().to_string();
            assert!(said.starts_with("sensor: line 1: ") && said.contains(says), "{said}");
        }
        for time in ["0.5", "0.25"] {
            let text = format!("{GOOD}\n{}\n", GOOD.replace("0.5", time));
            let mut poses = poses(&text);
            poses.next_pose().unwrap();
            let said = poses.next_pose().unwrap_err().to_string();
            assert_eq!(said, format!("sensor: line 2: time_s: {time} does not come after 0.5"));
        }
    }

    #[test]
    fn a_line_without_an_end_is_refused() {
        let endless = LivePoses::new(std::io::repeat(b' '), Path::new("sensor")).next_pose().unwrap_err();
        assert_eq!(endless.to_string(), "sensor: line 1: does not end within 64 KiB");
    }
}
