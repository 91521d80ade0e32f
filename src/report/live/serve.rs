//! Connections: what each asks for, and what all of them share.
//!
//! Who pushes a line takes a lock for as long as it takes to append one, and wakes who waits. A connection copies out
//! what is new to it and writes it without the lock: one that stalls is closed after a while, and may come again and go
//! on where it was.

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::frame::ShownFrame;
use super::history::{LineHistory, NumberedLine};
use crate::formats::http::{HttpRequest, HttpStatus, answer_head, event, read_request};

/// Connections that are open at a time; a page has two.
pub(super) const CONNECTIONS: usize = 32;
/// A client that says or takes nothing for so long is given up.
const PATIENCE: Duration = Duration::from_secs(5);
/// Least sign of life to a client while no line comes, which shows whether it is still there.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// Lines that are written in one go.
const BATCH: usize = 256;
/// Bytes of a refused request that are read before its connection is closed: closed at once, it would lose the answer.
const LEFT_OVER: usize = 64 << 10;
/// The page runs its own scripts and asks its own address, and no page of others may frame it.
const POLICY: &str = include_str!("../page/live.csp");

/// What all connections share.
pub(super) struct LiveState {
    html: String,
    /// Name of this run.
    run: String,
    /// Where it is served.
    pub(super) address: SocketAddr,
    shared: Mutex<SharedLines>,
    changed: Condvar,
}

struct SharedLines {
    history: LineHistory,
    /// The frame of the newest line.
    shown: Option<Arc<ShownFrame>>,
    /// What is said after the last line.
    end: Option<Arc<str>>,
    closed: bool,
    connections: usize,
    /// Those that follow the lines.
    followers: usize,
}

/// What a follower is to be sent.
enum LineBatch {
    Lines(Vec<NumberedLine>),
    End(Arc<str>),
    /// Nothing has come for a while.
    Nothing,
    Closed,
}

impl LiveState {
    pub(super) fn new(html: String, run: String, address: SocketAddr) -> Self {
        let (history, shown, end) = (LineHistory::new(), None, None);
        let shared = SharedLines { history, shown, end, closed: false, connections: 0, followers: 0 };
        LiveState { html, run, address, shared: Mutex::new(shared), changed: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, SharedLines> {
        // A panic elsewhere leaves nothing half done in here.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change<T>(&self, change: impl FnOnce(&mut SharedLines) -> T) -> T {
        let value = change(&mut self.lock());
        self.changed.notify_all();
        value
    }

    pub(super) fn push(&self, line: &str, frame: ShownFrame) {
        let (line, frame) = (line.into(), Arc::new(frame));
        let before = self.change(|shared| {
            shared.history.push(line);
            shared.shown.replace(frame)
        });
        // Without the lock: it may be the last to hold a picture.
        drop(before);
    }

    pub(super) fn end(&self, text: &str, patience: Duration) {
        self.change(|shared| shared.end = Some(text.into()));
        let wait = self.changed.wait_timeout_while(self.lock(), patience, |shared| shared.followers > 0);
        drop(wait);
    }

    /// Ends all threads, each as soon as it looks.
    pub(super) fn close(&self) {
        self.change(|shared| shared.closed = true);
        let ip = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        // Wakes the thread that waits for connections.
        drop(TcpStream::connect_timeout(&SocketAddr::new(ip, self.address.port()), PATIENCE));
    }

    /// Waits for lines from number `from` on.
    fn batch(&self, from: u64) -> LineBatch {
        let is_idle = |s: &mut SharedLines| !s.closed && s.end.is_none() && !s.history.reaches(from);
        let waited = self.changed.wait_timeout_while(self.lock(), HEARTBEAT, is_idle);
        let (shared, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let lines = shared.history.from(from, BATCH);
        match &shared.end {
            _ if shared.closed => LineBatch::Closed,
            _ if !lines.is_empty() => LineBatch::Lines(lines),
            Some(end) => LineBatch::End(Arc::clone(end)),
            None => LineBatch::Nothing,
        }
    }
}

/// Counts a connection, or a follower, as long as it lives.
struct Counted(Arc<LiveState>, fn(&mut SharedLines) -> &mut usize);

impl Counted {
    fn new(state: &Arc<LiveState>, count: fn(&mut SharedLines) -> &mut usize) -> Self {
        *count(&mut state.lock()) += 1;
        Counted(Arc::clone(state), count)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.change(|shared| *(self.1)(shared) -= 1);
    }
}

/// Takes connections until the page is closed.
pub(super) fn accept(listener: &TcpListener, state: &Arc<LiveState>) {
    for stream in listener.incoming() {
        let (closed, connections) = {
            let shared = state.lock();
            (shared.closed, shared.connections)
        };
        if closed {
            return;
        }
        let Ok(mut stream) = stream else {
            // For instance no file descriptor to be had: another moment has one.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        let ready = stream.set_write_timeout(Some(PATIENCE)).and_then(|()| stream.set_nodelay(true));
        if ready.is_err() {
            continue;
        }
        if connections >= CONNECTIONS {
            let _ = refuse(&mut stream, HttpStatus::Unavailable);
            continue;
        }
        // Counted before its thread begins: until then many more could come.
        let counted = Counted::new(state, |shared| &mut shared.connections);
        let state = Arc::clone(state);
        let client = move || {
            let _counted = counted;
            // A client that has gone away misses nothing.
            let _ = answer(&mut stream, &state);
        };
        // Without a thread to be had the connection is closed.
        let _ = std::thread::Builder::new().name("page client".into()).spawn(client);
    }
}

fn answer(stream: &mut TcpStream, state: &Arc<LiveState>) -> io::Result<()> {
    let request = match receive(stream)? {
        Ok(request) if is_own_host(&request.host, state.address.ip()) => request,
        Ok(_) => return refuse_gently(stream, HttpStatus::Forbidden),
        Err(status) => return refuse_gently(stream, status),
    };
    match request.path.as_str() {
        "/" => {
            let policy = ("Content-Security-Policy", POLICY.trim_end());
            send(stream, "text/html; charset=utf-8", state.html.as_bytes(), &[policy])
        }
        "/events" => follow(stream, state, &request),
        "/picture.jpg" => {
            let shown = state.lock().shown.clone();
            match shown.and_then(|shown| shown.jpeg(request.query_value("walls") == Some("1"))) {
                Some(jpeg) => send(stream, "image/jpeg", &jpeg, &[]),
                None => refuse_gently(stream, HttpStatus::NotFound),
            }
        }
        _ => refuse_gently(stream, HttpStatus::NotFound),
    }
}

/// The head of the request, or how it has to be refused.
fn receive(stream: &mut TcpStream) -> io::Result<Result<HttpRequest, HttpStatus>> {
    let start = Instant::now();
    let (mut bytes, mut chunk) = (Vec::new(), [0; 1024]);
    loop {
        // However slowly the bytes come.
        let left = PATIENCE.checked_sub(start.elapsed()).filter(|left| !left.is_zero());
        stream.set_read_timeout(Some(left.ok_or(io::ErrorKind::TimedOut)?))?;
        match stream.read(&mut chunk)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            count => bytes.extend_from_slice(&chunk[..count]),
        }
        if let Some(outcome) = read_request(&bytes).transpose() {
            return Ok(outcome);
        }
    }
}

/// Whether a request means this page. At a loopback address a page of somebody else's could reach it under a name of
/// its own that leads here (DNS rebinding), and read pictures.
fn is_own_host(host: &str, bound: IpAddr) -> bool {
    if !bound.is_loopback() {
        return true;
    }
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((ip, _)) => ip,
        None => host.split(':').next().unwrap_or_default(),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

fn send(stream: &mut TcpStream, content_type: &str, body: &[u8], more: &[(&str, &str)]) -> io::Result<()> {
    stream.write_all(answer_head(HttpStatus::Ok, content_type, Some(body.len()), more).as_bytes())?;
    stream.write_all(body)
}

fn refuse(stream: &mut TcpStream, status: HttpStatus) -> io::Result<()> {
    let body = format!("{}\n", status.words());
    stream.write_all((answer_head(status, "text/plain", Some(body.len()), &[]) + &body).as_bytes())
}

/// Refuses, and reads what else was sent.
fn refuse_gently(stream: &mut TcpStream, status: HttpStatus) -> io::Result<()> {
    refuse(stream, status)?;
    stream.shutdown(Shutdown::Write)?;
    io::copy(&mut stream.take(LEFT_OVER as u64), &mut io::sink()).map(drop)
}

/// Sends every line from where the client is, until the end.
fn follow(stream: &mut TcpStream, state: &Arc<LiveState>, request: &HttpRequest) -> io::Result<()> {
    let _counted = Counted::new(state, |shared| &mut shared.followers);
    stream.write_all(answer_head(HttpStatus::Ok, "text/event-stream", None, &[]).as_bytes())?;
    if request.query_value("run") != Some(&state.run) {
        return stream.write_all(event(None, "other", "{}").as_bytes());
    }
    // Milliseconds after which a browser comes again when the connection breaks.
    stream.write_all(b"retry: 1000\n\n")?;
    let mut next = request.last_event.map_or(0, |last| last.saturating_add(1));
    loop {
        match state.batch(next) {
            LineBatch::Lines(lines) => {
                let text: String = lines.iter().map(|(number, line)| event(Some(*number), "", line)).collect();
                stream.write_all(text.as_bytes())?;
                next = lines.last().map_or(next, |(number, _)| number + 1);
            }
            LineBatch::End(text) => return stream.write_all(event(None, "end", &text).as_bytes()),
            LineBatch::Nothing => stream.write_all(b":\n\n")?,
            LineBatch::Closed => return Ok(()),
        }
    }
}
