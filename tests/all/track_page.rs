//! The page of `track`, as a browser sees it while the program runs.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::Duration;

use crate::binary::{interrupt, program, run};
use crate::third_parties::refused;
use crate::track::{FRAMES, Place};

/// A test that would wait for ever fails after this.
const HANGS: Duration = Duration::from_secs(300);

/// `track --page` on a free port, and the address that it states.
fn serving(place: &Place, more: &[&str]) -> (Child, String, impl Read + use<>) {
    let mut command = program();
    command.args(place.words(&[&["--page", "127.0.0.1:0"], more].concat()));
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).stdin(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    let address = line.strip_prefix("page: http://").and_then(|rest| rest.strip_suffix("/\n"));
    let address = address.unwrap_or_else(|| panic!("standard error says {line:?}")).to_owned();
    (child, address, said)
}

fn ask(address: &str, target: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(HANGS)).unwrap();
    write!(stream, "GET {target} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    stream
}

/// What is still to come; of the events all until the end of the film.
fn rest(mut stream: TcpStream) -> String {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    String::from_utf8_lossy(&bytes).into_owned()
}

fn get(address: &str, target: &str) -> String {
    rest(ask(address, target))
}

fn data_of(events: &str) -> Vec<String> {
    events.lines().filter_map(|line| line.strip_prefix("data: ")).map(str::to_owned).collect()
}

fn run_of(page: &str) -> String {
    page.split("\"run\":\"").nth(1).unwrap().split('"').next().unwrap().to_owned()
}

#[test]
fn a_page_shows_the_lines_that_are_printed() {
    let place = Place::new();
    let (mut child, address, said) = serving(&place, &["--raw", "--every-frame", "--method", "ours-nav"]);
    // Before the first frame.
    let page = get(&address, "/");
    assert!(page.contains("\"airway\":{") && page.contains("<title>case1: ours-nav, live</title>"), "{page:.900}");
    // The one name of another host is that of a kind of document.
    assert_eq!(page.matches("://").count(), page.matches("http://www.w3.org/2000/svg").count());
    // The port is taken.
    let (film, words) = (place.text("films/case1"), ["another program uses this port"]);
    refused(run(&["track", "--sequence", &film, "--page", &address]), 4, &words);
    let (code, _, err) = run(&["track", "--sequence", &film, "--page", "nowhere"]);
    assert!(code == 2 && err.contains("needs an address and a port"), "{code}: {err}");

    let events = format!("/events?run={}", run_of(&page));
    let early = ask(&address, &events);
    child.stdin.take().unwrap().write_all(&place.raw()).unwrap();
    let seen = data_of(&rest(early));
    // One that comes after the end has the same.
    assert_eq!(data_of(&get(&address, &events)), seen);
    for target in ["/picture.jpg", "/picture.jpg?walls=1"] {
        assert!(get(&address, target).contains("image/jpeg"), "{target}");
    }

    assert!(child.try_wait().unwrap().is_none(), "the page stays after the last frame");
    interrupt(&child.id().to_string());
    let output = child.wait_with_output().unwrap();
    let said: String = BufReader::new(said).lines().map(|line| line.unwrap() + "\n").collect();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("frames answered") && said.contains("the page stays until Ctrl-C"), "{said}");
    let printed = String::from_utf8(output.stdout).unwrap();
    let printed: Vec<String> = printed.lines().map(str::to_owned).collect();
    let (lines, end) = seen.split_at(FRAMES);
    assert_eq!(lines, printed);
    assert!(end.len() == 1 && end[0].contains("\"frames\":9,\"left_out\":0,"), "{end:?}");
}

#[test]
fn a_run_that_fails_says_so_on_the_page_and_ends() {
    let place = Place::new();
    let (mut child, address, said) = serving(&place, &["--raw"]);
    let events = format!("/events?run={}", run_of(&get(&address, "/")));
    // Whoever is sent something is told of the end.
    let mut follower = ask(&address, &events);
    follower.read_exact(&mut [0]).unwrap();
    child.stdin.take().unwrap().write_all(&place.raw()[..10]).unwrap();
    let code = child.wait().unwrap().code();
    let said: String = BufReader::new(said).lines().map(|line| line.unwrap() + "\n").collect();
    assert_eq!(code, Some(4), "{said}");
    let seen = rest(follower);
    assert!(seen.contains("event: end") && seen.contains("ends after 10 of"), "{seen}");
}
