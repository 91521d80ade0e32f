//! The page as a browser sees it: through a socket.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use super::history::RECENT;
use super::serve::CONNECTIONS;
use super::*;
use crate::base::Image;
use crate::formats::http::MOST_HEAD_BYTES;
use crate::formats::jpeg;

/// A test that would wait for ever fails after this.
const HANGS: Duration = Duration::from_secs(60);

fn page() -> LivePage {
    let address = LiveAddress::take("127.0.0.1:0".parse().unwrap()).unwrap();
    LivePage::of_html(address, "<html>the page</html>".into(), "r1".into()).unwrap()
}

fn frame() -> ShownFrame {
    ShownFrame { image: Arc::new(Image::filled(16, 8, 3, 120u8)), wall: Box::new(|| None) }
}

fn connect(page: &LivePage, request: &str) -> TcpStream {
    let mut stream = TcpStream::connect(page.address()).unwrap();
    stream.set_read_timeout(Some(HANGS)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

fn get(target: &str, more: &str) -> String {
    format!("GET {target} HTTP/1.1\r\nHost: localhost:1\r\n{more}\r\n")
}

/// Head and body of an answer.
fn answer(page: &LivePage, request: &str) -> (String, Vec<u8>) {
    let mut bytes = Vec::new();
    connect(page, request).read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
    (String::from_utf8(bytes[..end].to_vec()).unwrap(), bytes[end + 4..].to_vec())
}

/// Lines of an event stream without its head and signs of life.
fn stream(page: &LivePage, more: &str) -> impl Iterator<Item = String> + use<> {
    let lines = BufReader::new(connect(page, &get("/events?run=r1", more))).lines().map(Result::unwrap);
    lines
        .skip_while(|line| !line.is_empty())
        .filter(|line| !line.is_empty() && line != ":" && !line.starts_with("retry"))
}

fn end() -> LiveEnd {
    LiveEnd { frames: 3, left_out: 0, latency_ms: [1.0, 2.0], error: None }
}

const END: &str = r#"data: {"frames":3,"left_out":0,"latency_ms":[1.0,2.0],"error":null}"#;

#[test]
fn the_page_is_served_to_its_own_address_and_nothing_else_is() {
    let page = page();
    let (head, body) = answer(&page, &get("/", ""));
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("default-src 'none'"), "{head}");
    assert_eq!(body, b"<html>the page</html>");
    let long = format!("GET / HTTP/1.1\r\nX: {}\r\n\r\n", "a".repeat(3 * MOST_HEAD_BYTES));
    for (request, status) in [
        (get("/etc/passwd", "").as_str(), "404"),
        (&get("/picture.jpg", ""), "404"),
        (&get("/", "").replace("GET", "POST"), "405"),
        (&get("/", "").replace("localhost", "elsewhere.example"), "403"),
        (&get("/", "").replace("localhost:1", "[::1]:8080"), "200"),
        ("GET / HTTP/1.1\r\n\r\n", "403"),
        ("\0\u{1}\r\n\r\n", "400"),
        (&long, "431"),
    ] {
        let (head, _) = answer(&page, request);
        assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{request:.60}: {head}");
    }
}

#[test]
fn a_follower_gets_every_line_whenever_it_comes() {
    let page = page();
    page.push("{\"frame\":0}", frame());
    let mut early = stream(&page, "");
    // It has the first line before the second one is there.
    assert_eq!([early.next().unwrap(), early.next().unwrap()], ["id: 0", "data: {\"frame\":0}"]);
    for k in 1..3 {
        page.push(&format!("{{\"frame\":{k}}}"), frame());
        assert_eq!(
            [early.next().unwrap(), early.next().unwrap()],
            [format!("id: {k}"), format!("data: {{\"frame\":{k}}}")]
        );
    }
    // One that comes late, and one whose connection broke off after the first line.
    let (late, again) = (stream(&page, ""), stream(&page, "Last-Event-ID: 0\r\n"));
    page.end(&end());
    let rest: Vec<String> = again.collect();
    assert_eq!(rest, ["id: 1", "data: {\"frame\":1}", "id: 2", "data: {\"frame\":2}", "event: end", END]);
    let all: Vec<String> = late.collect();
    assert_eq!(
        (all.len(), &all[..2], &all[2..]),
        (8, ["id: 0", "data: {\"frame\":0}"].map(String::from).as_slice(), &rest[..])
    );
    assert_eq!(early.collect::<Vec<_>>(), ["event: end", END]);
    // After the end, too; and the page of a run before this one is told to load anew.
    assert_eq!(stream(&page, "").collect::<Vec<_>>(), all);
    let (_, other) = answer(&page, &get("/events?run=r0", ""));
    assert_eq!(other, b"event: other\ndata: {}\n\n");
}

#[test]
fn a_client_that_never_reads_holds_nobody_up() {
    let page = Arc::new(page());
    let stalled = connect(&page, &get("/events?run=r1", ""));
    let (done, is_done) = mpsc::channel();
    let pushing = Arc::clone(&page);
    // More than all buffers of sockets hold: whoever waited for the client would wait for ever.
    let count = 40 * RECENT;
    std::thread::spawn(move || {
        let line = "x".repeat(3000);
        (0..count).for_each(|_| pushing.push(&line, frame()));
        done.send(()).unwrap();
    });
    is_done.recv_timeout(HANGS).expect("pushing waits for a client that does not read");
    page.push("{\"last\":1}", frame());
    let mut seen = stream(&page, "");
    assert!(seen.any(|line| line == "data: {\"last\":1}"), "another client gets the newest line");
    drop(stalled);
}

#[test]
fn connections_beyond_the_limit_are_refused_however_fast_they_come() {
    let page = page();
    let mut open: Vec<TcpStream> = (0..CONNECTIONS + 8).map(|_| connect(&page, "")).collect();
    for refused in &mut open[CONNECTIONS..] {
        let mut head = String::new();
        refused.read_to_string(&mut head).unwrap();
        assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
    }
    // Each that goes makes room.
    open.clear();
    let is_served = || {
        let mut bytes = Vec::new();
        // One that is refused may be closed before its request was read.
        connect(&page, &get("/", "")).read_to_end(&mut bytes).is_ok() && bytes.starts_with(b"HTTP/1.1 200 ")
    };
    let start = std::time::Instant::now();
    while !is_served() {
        assert!(start.elapsed() < HANGS, "connections that are gone are counted");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn pictures_are_drawn_when_they_are_asked_for() {
    let page = page();
    let drawn = Arc::new(AtomicUsize::new(0));
    for _ in 0..3 {
        let counted = Arc::clone(&drawn);
        let wall = move || {
            counted.fetch_add(1, Ordering::SeqCst);
            // The right half is wall.
            Some(Image {
                width: 16,
                height: 8,
                channels: 1,
                data: (0..128).map(|k| if k % 16 < 8 { 0 } else { 255 }).collect(),
            })
        };
        page.push("{}", ShownFrame { image: Arc::new(Image::filled(16, 8, 3, 120u8)), wall: Box::new(wall) });
    }
    let (head, plain) = answer(&page, &get("/picture.jpg", ""));
    assert!(head.contains("Content-Type: image/jpeg"), "{head}");
    assert_eq!(drawn.load(Ordering::SeqCst), 0);
    let (_, tinted) = answer(&page, &get("/picture.jpg?walls=1", ""));
    assert_eq!(drawn.load(Ordering::SeqCst), 1);
    let [plain, tinted] = [plain, tinted].map(|bytes| jpeg::decode_rgb(&bytes).unwrap());
    let blue = |image: &Image<u8>, x: usize| i32::from(image.pixel(x, 4)[2]) - i32::from(image.pixel(x, 4)[0]);
    assert!(blue(&plain, 2).abs() < 9 && blue(&tinted, 2) > 60 && blue(&tinted, 14).abs() < 25);
}

#[test]
fn an_address_in_use_is_refused_in_a_sentence() {
    let page = page();
    let error = LiveAddress::take(page.address()).err().unwrap();
    let wanted = format!("page at {}: another program uses this port; port 0 takes a free one", page.address());
    assert_eq!((error.to_string(), error.kind().exit_code()), (wanted, 4));
    // And given back.
    let address = page.address();
    drop(page);
    let start = std::time::Instant::now();
    while LiveAddress::take(address).is_err() {
        assert!(start.elapsed() < HANGS, "the address of a page that is gone stays in use");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn the_error_of_a_run_is_told() {
    let page = page();
    page.end(&LiveEnd { error: Some("frame 3: ends".into()), ..end() });
    let told: Vec<String> = stream(&page, "").collect();
    assert!(told[0] == "event: end" && told[1].contains("\"error\":\"frame 3: ends\""), "{told:?}");
}
