//! Which process works in a folder: a claim, for as long as the work takes.
//!
//! A claim is a folder `.claim` in the claimed one, renamed into place with `holder.json` inside, which one process of
//! all succeeds in, on a network file system too. The holder sets the file's time of change every two seconds. A claim
//! is dead, and is taken over, when its process has ended (on the same machine), or when that time has not changed for
//! [`DEAD_AFTER`] by the clock of the process that waits: clocks of two machines are never compared.
//!
//! A holder that was merely stopped for longer wakes up to find its claim another's ([`Claim::is_held`]): its work is
//! thrown away, and what the other process publishes has the same bytes.

use std::collections::HashMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::base::{Error, Result, files, hash};

/// Name of the claim within the claimed folder.
const CLAIM: &str = ".claim";
/// Name of the file in it.
const HOLDER: &str = "holder.json";
/// How the name of a claim begins that is on its way into place.
const OWN_CLAIM: &str = ".claim-";
/// How that of a claim begins that was taken from an ended process.
const DEAD: &str = ".dead-";
/// How that of a claim begins that is given back.
const RELEASED: &str = ".released-";
/// How that of something begins that an ended process left.
const SWEPT: &str = ".swept-";
/// How that of a product begins that is being made; the product's name and the claim's token follow.
pub(super) const MAKING: &str = ".making-";
/// How that of a product begins that another one replaces.
pub(super) const DISCARDED: &str = ".discarded-";
/// All of what this program keeps out of sight in a claimed folder, unfinished files aside.
const UNFINISHED: [&str; 6] = [OWN_CLAIM, DEAD, RELEASED, SWEPT, MAKING, DISCARDED];
/// How often a holder shows that it lives.
const BEAT: Duration = Duration::from_secs(2);
/// How long a holder may show nothing.
pub const DEAD_AFTER: Duration = Duration::from_secs(30);

/// Nothing that these mutexes hold is left half done by a panic.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The process that holds a claim.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Holder {
    /// Name of the machine.
    pub host: String,
    /// Process number on it.
    pub process: u32,
    /// Which start of the machine, and which view of its processes, that number belongs to.
    pub system: String,
    /// When the process was started, in ticks of the machine's clock: numbers are used again.
    pub started: String,
    /// Seconds since 1970 by its own clock, for people.
    pub since_unix_s: u64,
    /// Unlike that of any other claim.
    pub token: String,
}

impl Holder {
    fn new() -> Holder {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let (process, system) = (std::process::id(), this_system());
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        // Text hashes whatever is in it.
        let unique = hash::of_bytes(format!("{system} {process} {count} {}", now.as_nanos()).as_bytes());
        Holder {
            host: read_trimmed("/proc/sys/kernel/hostname"),
            process,
            system,
            started: start_of(process).unwrap_or_default(),
            since_unix_s: now.as_secs(),
            token: unique[..16].to_owned(),
        }
    }

    /// Whether the process is known to have ended: on another system nothing is known, nor of another user's process
    /// where the system hides those (`/proc` mounted with `hidepid`).
    fn has_ended(&self) -> bool {
        self.system == this_system() && start_of(self.process).map_or_else(all_are_seen, |start| start != self.started)
    }
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.host.as_str() {
            // It has claimed the work and not yet said who it is.
            "" => write!(f, "another process"),
            host => write!(f, "process {} on {host}", self.process),
        }
    }
}

fn read_trimmed(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_default().trim().to_owned()
}

/// The machine's start and the namespace of process numbers.
fn this_system() -> String {
    let namespace = fs::read_link("/proc/self/ns/pid").unwrap_or_default();
    format!("{} {}", read_trimmed("/proc/sys/kernel/random/boot_id"), namespace.display())
}

/// When a process was started, in clock ticks since the machine was (field 22 of its `stat`); `None` when there is none.
fn start_of(process: u32) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The name in brackets may hold blanks and brackets.
    let fields: Vec<&str> = stat[stat.rfind(')')? + 1..].split_whitespace().collect();
    // A zombie works no more. After the name stand fields 3 (state) and on.
    if fields.first() == Some(&"Z") { None } else { fields.get(19).map(|field| (*field).to_owned()) }
}

/// Whether every user's processes are seen: the first one is somebody else's, and always there.
fn all_are_seen() -> bool {
    Path::new("/proc/1/stat").exists()
}

/// What came of asking for a claim.
#[derive(Debug)]
pub enum Asked {
    /// It is ours.
    Granted(Claim),
    /// Another process has it.
    Held(Holder),
}

/// A claim of this process. Dropped without [`Claim::release`], it is given back as far as that is possible.
#[derive(Debug)]
pub struct Claim {
    folder: PathBuf,
    holder: Holder,
    heart: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Claim {
    /// Unlike that of any other claim: for names of unfinished folders.
    pub fn token(&self) -> &str {
        &self.holder.token
    }

    /// Gives the folder back.
    pub fn release(mut self) -> Result<()> {
        self.stop();
        self.remove()
    }

    /// Whether the folder is still this process': false once another one has taken it for dead.
    ///
    /// Errors: a claim that cannot be read.
    pub fn is_held(&self) -> Result<bool> {
        Ok(holder_of(&self.folder.join(CLAIM))?.is_some_and(|holder| holder.token == self.holder.token))
    }

    /// The process that has the folder now; this one where nobody has.
    ///
    /// Errors: a claim that cannot be read.
    pub fn holder_now(&self) -> Result<Holder> {
        Ok(holder_of(&self.folder.join(CLAIM))?.unwrap_or_else(|| self.holder.clone()))
    }

    fn stop(&mut self) {
        if let Some((sender, thread)) = self.heart.take() {
            drop(sender);
            let _ = thread.join();
        }
    }

    fn remove(&self) -> Result<()> {
        // Taken over by another process: it is no longer ours to remove.
        if !self.is_held()? {
            return Ok(());
        }
        remove_claim_of(&self.folder, &self.holder, &format!("{RELEASED}{}", self.holder.token))
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if self.heart.is_some() {
            self.stop();
            let _ = self.remove();
        }
    }
}

/// Asks for claims, and remembers how long others have shown no life.
#[derive(Debug, Default)]
pub struct Claims {
    /// By token: the holder's last sign of life, and when this process first saw it.
    signs: Mutex<HashMap<(PathBuf, String), (SystemTime, Instant)>>,
}

impl Claims {
    /// Claims `folder`, which is made when missing. A dead process' claim is taken over; what it left unfinished
    /// is removed but for names that begin with one of `kept`.
    ///
    /// Errors: a folder that cannot be read or written.
    pub fn ask(&self, folder: &Path, kept: &[&str]) -> Result<Asked> {
        let claim = folder.join(CLAIM);
        loop {
            fs::create_dir_all(folder).map_err(|e| Error::io("making the folder", folder, e))?;
            if let Some(holder) = holder_of(&claim)? {
                if !self.is_dead(&claim, &holder)? {
                    return Ok(Asked::Held(holder));
                }
                break_claim(folder, &holder)?;
            }
            if let Some(granted) = grant(folder)? {
                remove_unfinished(folder, kept)?;
                return Ok(Asked::Granted(granted));
            }
        }
    }

    fn is_dead(&self, claim: &Path, holder: &Holder) -> Result<bool> {
        if holder.has_ended() {
            return Ok(true);
        }
        // Opened anew: network file systems then ask the server. A claim without a holder shows life by its own time.
        let sign_of = |path: &Path| File::open(path)?.metadata()?.modified();
        let path = claim.join(HOLDER);
        let missing = |e: &std::io::Error| e.kind() == std::io::ErrorKind::NotFound;
        let sign = match sign_of(&path) {
            Err(e) if missing(&e) => sign_of(claim),
            sign => sign,
        };
        let sign = match sign {
            Err(e) if missing(&e) => return Ok(false),
            sign => sign.map_err(|e| Error::io("reading", &path, e))?,
        };
        let mut signs = lock(&self.signs);
        let (last, since) = signs.entry((claim.to_owned(), holder.token.clone())).or_insert((sign, Instant::now()));
        if *last != sign {
            (*last, *since) = (sign, Instant::now());
        }
        Ok(since.elapsed() > DEAD_AFTER)
    }
}

/// Who holds a claim; `None` when nobody does. A claim that cannot be understood, or that names nobody (a folder that was
/// copied in part), has a holder of whom nothing is known.
fn holder_of(claim: &Path) -> Result<Option<Holder>> {
    let unknown = || Holder {
        host: String::new(),
        process: 0,
        system: String::new(),
        started: String::new(),
        since_unix_s: 0,
        token: String::new(),
    };
    let path = claim.join(HOLDER);
    match fs::read(&path) {
        Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes).unwrap_or_else(|_| unknown()))),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(claim.is_dir().then(unknown)),
        Err(e) => Err(Error::io("reading", &path, e)),
    }
}

/// Renames a claim with this process in it into place; `None` when another one was faster.
fn grant(folder: &Path) -> Result<Option<Claim>> {
    let holder = Holder::new();
    let (claim, own) = (folder.join(CLAIM), folder.join(format!("{OWN_CLAIM}{}", holder.token)));
    match write_holder(&own, &holder).and_then(|()| fs::rename(&own, &claim)) {
        Ok(()) => {}
        // Swept away by a process that took `folder` in between, and may have given it back.
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) if is_occupied(&e) => {
            remove_folder(&own)?;
            return Ok(None);
        }
        Err(e) => return Err(Error::io("writing", &own.join(HOLDER), e)),
    }
    let path = claim.join(HOLDER);
    let file = File::open(&path).map_err(|e| Error::io("reading", &path, e))?;
    let (sender, receiver) = mpsc::channel::<()>();
    let beat = move || {
        while receiver.recv_timeout(BEAT) == Err(RecvTimeoutError::Timeout) {
            // Where it fails, others will take this process for dead, and that is all.
            let _ = file.set_modified(SystemTime::now());
        }
    };
    let thread = std::thread::Builder::new().name("claim".into()).spawn(beat);
    let thread = thread.map_err(|e| Error::io("starting its thread", &claim, e))?;
    Ok(Some(Claim { folder: folder.to_path_buf(), holder, heart: Some((sender, thread)) }))
}

fn write_holder(own: &Path, holder: &Holder) -> std::io::Result<()> {
    fs::create_dir(own)?;
    fs::write(own.join(HOLDER), serde_json::to_vec(holder)?)
}

/// Takes a dead holder's claim away, unless another process was faster.
fn break_claim(folder: &Path, dead: &Holder) -> Result<()> {
    remove_claim_of(folder, dead, &format!("{DEAD}{}", Holder::new().token))
}

/// Removes the claim on a folder if it is this holder's, by way of the name `aside`. None there is fine.
fn remove_claim_of(folder: &Path, holder: &Holder, aside: &str) -> Result<()> {
    let (claim, aside) = (folder.join(CLAIM), folder.join(aside));
    match fs::rename(&claim, &aside) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        renamed => renamed.map_err(|e| Error::io("writing", &claim, e))?,
    }
    // Between looking and renaming, another process may have taken it over: then it gets its claim back.
    if holder_of(&aside)?.is_some_and(|found| found.token != holder.token) && fs::rename(&aside, &claim).is_ok() {
        return Ok(());
    }
    remove_folder(&aside)
}

/// What the system says where a folder with content is in the way of a rename.
pub(super) fn is_occupied(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::DirectoryNotEmpty | std::io::ErrorKind::AlreadyExists)
}

/// Removes a folder or file in two steps, so that nobody sees a part of it. None there is fine.
pub(super) fn remove_renamed(path: &Path, aside: &Path) -> Result<()> {
    match fs::rename(path, aside) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io("removing", path, e)),
        Ok(()) => remove_folder(aside),
    }
}

/// Removes a folder with all that is in it, or a file. None there is fine.
pub(super) fn remove_folder(path: &Path) -> Result<()> {
    let outcome = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match outcome {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("removing", path, e)),
        _ => Ok(()),
    }
}

/// Names of what this program has begun in a folder that is there, the claim aside. Whatever else is hidden there is
/// somebody's own (`.git`, `.nojekyll`, what a network file system keeps).
pub(super) fn unfinished(folder: &Path) -> Result<Vec<String>> {
    let fail = |e| Error::io("reading", folder, e);
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        let name = entry.map_err(fail)?.file_name().to_string_lossy().into_owned();
        if UNFINISHED.iter().any(|start| name.starts_with(start)) || files::is_unfinished(&name) {
            names.push(name);
        }
    }
    Ok(names)
}

/// Whether anybody claims the folder, dead or alive.
pub(super) fn is_claimed(folder: &Path) -> bool {
    folder.join(CLAIM).exists()
}

/// Clears away what was unfinished when its process ended.
fn remove_unfinished(folder: &Path, kept: &[&str]) -> Result<()> {
    let is_kept = |name: &String| kept.iter().any(|k| name.starts_with(k));
    // A process that slept may wake up and publish what is being removed: it finds all of it or nothing.
    let remove = |name: &String| {
        let aside = folder.join(format!("{SWEPT}{}", Holder::new().token));
        remove_renamed(&folder.join(name), &aside)
    };
    unfinished(folder)?.iter().filter(|name| !is_kept(name)).try_for_each(remove)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn granted(claims: &Claims, folder: &Path) -> Option<Claim> {
        match claims.ask(folder, &[]).unwrap() {
            Asked::Granted(claim) => Some(claim),
            Asked::Held(_) => None,
        }
    }

    /// A claim as another process would have left it.
    fn plant(folder: &Path, change: impl FnOnce(&mut Holder)) {
        let mut holder = Holder::new();
        change(&mut holder);
        files::write_json(&folder.join(CLAIM).join(HOLDER), &holder).unwrap();
    }

    #[test]
    fn one_of_many_gets_it_and_it_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let claims = Claims::default();
        for _ in 0..20 {
            let count = AtomicU64::new(0);
            let barrier = std::sync::Barrier::new(8);
            std::thread::scope(|scope| {
                for _ in 0..8 {
                    scope.spawn(|| {
                        barrier.wait();
                        let claim = granted(&claims, folder.path());
                        count.fetch_add(u64::from(claim.is_some()), Ordering::SeqCst);
                        // Nobody gives it back before all have asked.
                        barrier.wait();
                        claim.map(Claim::release).transpose().unwrap();
                    });
                }
            });
            assert_eq!(count.into_inner(), 1);
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left over");
        }
    }

    #[test]
    fn an_ended_process_loses_its_claim_and_a_live_or_a_foreign_one_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let claims = Claims::default();
        plant(folder.path(), |_| {});
        assert!(granted(&claims, folder.path()).is_none(), "this process lives");
        plant(folder.path(), |holder| holder.system = "another machine".into());
        assert!(granted(&claims, folder.path()).is_none(), "nothing is known of it yet");
        // Its sign of life is as old as that: by the waiting process' own clock.
        for (_, since) in lock(&claims.signs).values_mut() {
            *since -= DEAD_AFTER;
        }
        fs::write(folder.path().join(".Ab12cd.tmp"), "half").unwrap();
        fs::create_dir(folder.path().join(".making-film-0123")).unwrap();
        // Somebody's own.
        fs::create_dir(folder.path().join(".git")).unwrap();
        fs::write(folder.path().join(".git/HEAD"), "ref: refs/heads/main").unwrap();
        assert!(granted(&claims, folder.path()).is_some(), "it has shown no life");
        assert_eq!(unfinished(folder.path()).unwrap(), [""; 0]);
        assert!(folder.path().join(".git/HEAD").exists(), "what others keep there is not swept away");
        fs::remove_dir_all(folder.path().join(".git")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        plant(folder.path(), |holder| holder.started = "1".into());
        assert!(granted(&claims, folder.path()).is_some(), "the number was given to another process");
        fs::create_dir(folder.path().join(CLAIM)).unwrap();
        fs::write(folder.path().join(CLAIM).join(HOLDER), "{").unwrap();
        assert!(granted(&claims, folder.path()).is_none());
        lock(&claims.signs).values_mut().for_each(|(_, since)| *since -= DEAD_AFTER);
        assert!(granted(&claims, folder.path()).is_some(), "rubbish shows no life either");
        // A claim that was copied in part: with a file, but without a holder.
        fs::create_dir(folder.path().join(CLAIM)).unwrap();
        fs::write(folder.path().join(CLAIM).join("x"), "").unwrap();
        assert!(granted(&claims, folder.path()).is_none(), "it is not asked for again and again");
        lock(&claims.signs).values_mut().for_each(|(_, since)| *since -= DEAD_AFTER);
        assert!(granted(&claims, folder.path()).is_some());
    }

    #[test]
    fn a_live_holder_shows_life() {
        let folder = tempfile::tempdir().unwrap();
        let claim = granted(&Claims::default(), folder.path()).unwrap();
        let sign = || fs::metadata(folder.path().join(CLAIM).join(HOLDER)).unwrap().modified().unwrap();
        let before = sign();
        std::thread::sleep(BEAT + Duration::from_millis(500));
        assert!(sign() > before);
        drop(claim);
        assert!(!is_claimed(folder.path()));
    }

    #[test]
    fn who_was_taken_over_leaves_the_others_claim_alone() {
        let folder = tempfile::tempdir().unwrap();
        let claims = Claims::default();
        let slept = granted(&claims, folder.path()).unwrap();
        assert!(slept.is_held().unwrap());
        plant(folder.path(), |holder| holder.token = "another".into());
        assert!(!slept.is_held().unwrap());
        assert_eq!(slept.holder_now().unwrap().token, "another");
        slept.release().unwrap();
        assert!(is_claimed(folder.path()));
    }
}
