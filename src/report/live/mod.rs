//! The page of `track`: the report's airway, live. One thread takes connections, each has a thread of its own, and who
//! pushes lines waits for none of them.
//!
//! ```text
//! /               the page: airway, looks and scripts in one file, which asks nobody but this address
//! /events?run=R   every line so far and every further one, as server-sent events; `end` after the last one, `other`
//!                 where R is another run, whose page is still open
//! /picture.jpg    the frame of the newest line; with ?walls=1 what did not count as wall is tinted
//! ```
//!
//! A picture is encoded when it is asked for, so that a run that nobody looks at encodes none.

mod frame;
mod history;
mod page;
mod serve;
#[cfg(test)]
mod tests;

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;

pub use self::frame::ShownFrame;
use self::serve::LiveState;
use crate::base::{Error, Result};
use crate::simulate::participant::Given;

/// How long the end of a run waits for pages to be told.
const GOODBYE: Duration = Duration::from_secs(1);

/// How a run ended.
#[derive(Clone, Debug, Serialize)]
pub struct LiveEnd {
    /// Frames answered.
    pub frames: usize,
    /// Frames left out.
    pub left_out: usize,
    /// Latency that half of the answers and 99 % of them stay within, milliseconds.
    pub latency_ms: [f64; 2],
    /// Why it ended before the film did.
    pub error: Option<String>,
}

/// An address that is taken and not served yet.
pub struct LiveAddress(TcpListener);

impl LiveAddress {
    /// Takes an address; port 0 takes any free port. Errors: it is in use, or no address of this machine.
    pub fn take(address: SocketAddr) -> Result<Self> {
        let failed = |e: std::io::Error| {
            let why = match e.kind() {
                std::io::ErrorKind::AddrInUse => "another program uses this port; port 0 takes a free one".to_owned(),
                _ => format!("cannot be served: {e}"),
            };
            Error::input(why).element(format!("page at {address}"))
        };
        TcpListener::bind(address).map(LiveAddress).map_err(failed)
    }
}

/// A page that is served until this is dropped.
pub struct LivePage {
    state: Arc<LiveState>,
}

impl LivePage {
    /// Serves the page of `method` that follows `film`, whose name is `name`.
    ///
    /// Errors: surfaces that cannot be read; no thread or address to be had.
    pub fn serve(address: LiveAddress, film: &dyn Given, name: &str, method: &str) -> Result<Self> {
        // Tells this run from one before it at the same address.
        let run = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
        let run = format!("{run:x}");
        Self::of_html(address, page::live_page(film, name, method, &run)?, run)
    }

    fn of_html(LiveAddress(listener): LiveAddress, html: String, run: String) -> Result<Self> {
        let failed = |e: std::io::Error| Error::input(format!("cannot be served: {e}")).element("page");
        let address = listener.local_addr().map_err(failed)?;
        let state = Arc::new(LiveState::new(html, run, address));
        let served = Arc::clone(&state);
        std::thread::Builder::new()
            .name("page".into())
            .spawn(move || serve::accept(&listener, &served))
            .map_err(failed)?;
        Ok(LivePage { state })
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.state.address
    }

    /// Shows a line. Never waits for a page.
    pub fn push(&self, line: &str, frame: ShownFrame) {
        self.state.push(line, frame);
    }

    /// Says that no line follows, and waits a moment until the pages that are open know.
    pub fn end(&self, how: &LiveEnd) {
        let text = serde_json::to_string(how).unwrap_or_else(|_| "{}".into());
        self.state.end(&text, GOODBYE);
    }
}

impl Drop for LivePage {
    fn drop(&mut self) {
        self.state.close();
    }
}
