//! HTTP/1.1 as far as a small page needs it (RFC 9112): the head of a GET request, and the head of an answer. Bodies of
//! requests, other methods, percent-encoding and connections that are used twice are left out.

/// Most bytes of a request's head: browsers send less than one KiB to a page without cookies.
pub const MOST_HEAD_BYTES: usize = 8 << 10;
/// End of a head.
const END: &[u8] = b"\r\n\r\n";

/// How a request is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HttpStatus {
    /// What was asked for follows.
    Ok,
    /// The request breaks the format.
    BadRequest,
    /// The request names another host than this one.
    Forbidden,
    /// There is no such path.
    NotFound,
    /// Another method than GET.
    MethodNotAllowed,
    /// The head has more than [`MOST_HEAD_BYTES`].
    HeadTooLarge,
    /// Too many connections are open.
    Unavailable,
}

impl HttpStatus {
    /// Code and reason.
    pub fn words(self) -> &'static str {
        match self {
            HttpStatus::Ok => "200 OK",
            HttpStatus::BadRequest => "400 Bad Request",
            HttpStatus::Forbidden => "403 Forbidden",
            HttpStatus::NotFound => "404 Not Found",
            HttpStatus::MethodNotAllowed => "405 Method Not Allowed",
            HttpStatus::HeadTooLarge => "431 Request Header Fields Too Large",
            HttpStatus::Unavailable => "503 Service Unavailable",
        }
    }
}

/// What a GET request asks for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HttpRequest {
    /// With its slash, without the query.
    pub path: String,
    /// Key and value of each part of the query; no percent-encoding is undone.
    pub query: Vec<(String, String)>,
    /// Host and port that the client believes to speak to; empty where it names none.
    pub host: String,
    /// Last number that an event stream had before it broke off.
    pub last_event: Option<u64>,
}

impl HttpRequest {
    /// Value of a key of the query.
    pub fn query_value(&self, key: &str) -> Option<&str> {
        self.query.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }
}

/// Reads the head of a request from what has come so far; `None` where its end has not come yet.
///
/// Errors: how the request has to be refused.
pub fn read_request(bytes: &[u8]) -> Result<Option<HttpRequest>, HttpStatus> {
    let Some(end) = bytes.windows(END.len()).position(|window| window == END) else {
        return if bytes.len() >= MOST_HEAD_BYTES { Err(HttpStatus::HeadTooLarge) } else { Ok(None) };
    };
    if end > MOST_HEAD_BYTES {
        return Err(HttpStatus::HeadTooLarge);
    }
    let text = std::str::from_utf8(&bytes[..end]).map_err(|_| HttpStatus::BadRequest)?;
    let mut lines = text.split("\r\n");
    let words: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
    let &[method, target, version] = words.as_slice() else { return Err(HttpStatus::BadRequest) };
    let is_plain = |text: &str| text.bytes().all(|b| b.is_ascii_graphic());
    let is_known = matches!(version, "HTTP/1.1" | "HTTP/1.0");
    if method.is_empty() || !is_plain(method) || !target.starts_with('/') || !is_plain(target) || !is_known {
        return Err(HttpStatus::BadRequest);
    }
    if method != "GET" {
        return Err(HttpStatus::MethodNotAllowed);
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let pair = |part: &str| {
        let (key, value) = part.split_once('=').unwrap_or((part, ""));
        (key.to_owned(), value.to_owned())
    };
    let mut request = HttpRequest {
        path: path.to_owned(),
        query: query.split('&').filter(|part| !part.is_empty()).map(pair).collect(),
        ..HttpRequest::default()
    };
    for line in lines {
        let (name, value) = line.split_once(':').ok_or(HttpStatus::BadRequest)?;
        if name.is_empty() || !is_plain(name) || value.chars().any(|c| c.is_control() && c != '\t') {
            return Err(HttpStatus::BadRequest);
        }
        let value = value.trim();
        match name.to_ascii_lowercase().as_str() {
            "host" if !request.host.is_empty() => return Err(HttpStatus::BadRequest),
            "host" => request.host = value.to_owned(),
            // Browsers repeat what they were sent: anything else is as good as nothing.
            "last-event-id" => request.last_event = value.parse().ok(),
            _ => {}
        }
    }
    Ok(Some(request))
}

/// The head of an answer, after which the connection is closed. Without a length the body ends where the connection
/// does. Nothing of an answer is stored, guessed at, or given to a page of another origin.
pub fn answer_head(status: HttpStatus, content_type: &str, length: Option<usize>, more: &[(&str, &str)]) -> String {
    let mut head = format!(
        "HTTP/1.1 {}\r\nContent-Type: {content_type}\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         Cross-Origin-Resource-Policy: same-origin\r\nConnection: close\r\n",
        status.words()
    );
    if let Some(length) = length {
        head += &format!("Content-Length: {length}\r\n");
    }
    if status == HttpStatus::MethodNotAllowed {
        head += "Allow: GET\r\n";
    }
    for (name, value) in more {
        head += &format!("{name}: {value}\r\n");
    }
    head + "\r\n"
}

/// An event of a stream (`text/event-stream`): `data`, which has no line ends, under a number and a name; an event
/// without a name is a message.
pub fn event(number: Option<u64>, name: &str, data: &str) -> String {
    let number = number.map_or_else(String::new, |number| format!("id: {number}\n"));
    let name = if name.is_empty() { String::new() } else { format!("event: {name}\n") };
    format!("{number}{name}data: {data}\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_read_once_it_is_whole() {
        let text = b"GET /picture.jpg?walls=1&frame HTTP/1.1\r\nHost: localhost:80\r\nLAST-event-id:  17 \r\n\r\n";
        for cut in 0..text.len() - 1 {
            assert_eq!(read_request(&text[..cut]), Ok(None), "{cut}");
        }
        let request = read_request(text).unwrap().unwrap();
        assert_eq!((request.path.as_str(), request.host.as_str()), ("/picture.jpg", "localhost:80"));
        assert_eq!(request.last_event, Some(17));
        assert_eq!([request.query_value("walls"), request.query_value("frame")], [Some("1"), Some("")]);
        assert_eq!(request.query_value("other"), None);
    }

    #[test]
    fn what_is_no_request_for_a_page_is_refused() {
        for (text, status) in [
            ("POST / HTTP/1.1\r\n\r\n", HttpStatus::MethodNotAllowed),
            ("HEAD / HTTP/1.1\r\n\r\n", HttpStatus::MethodNotAllowed),
            ("GET  / HTTP/1.1\r\n\r\n", HttpStatus::BadRequest),
            ("GET / HTTP/2\r\n\r\n", HttpStatus::BadRequest),
            ("GET http://elsewhere/ HTTP/1.1\r\n\r\n", HttpStatus::BadRequest),
            ("GET /\r\n\r\n", HttpStatus::BadRequest),
            ("\r\n\r\n", HttpStatus::BadRequest),
            ("GET / HTTP/1.1\r\nno colon\r\n\r\n", HttpStatus::BadRequest),
            ("GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", HttpStatus::BadRequest),
            ("GET / HTTP/1.1\r\nX: a\nb\r\n\r\n", HttpStatus::BadRequest),
        ] {
            assert_eq!(read_request(text.as_bytes()), Err(status), "{text:?}");
        }
        assert_eq!(read_request(b"GET /\xff HTTP/1.1\r\n\r\n"), Err(HttpStatus::BadRequest));
        let endless = [b"GET / HTTP/1.1\r\nX: ".as_slice(), &vec![b'a'; MOST_HEAD_BYTES]].concat();
        assert_eq!(read_request(&endless), Err(HttpStatus::HeadTooLarge));
    }

    #[test]
    fn answers_have_their_heads() {
        let head = answer_head(HttpStatus::MethodNotAllowed, "text/plain", Some(3), &[("X-A", "b")]);
        assert!(head.starts_with("HTTP/1.1 405 Method Not Allowed\r\n") && head.ends_with("\r\n\r\n"), "{head}");
        assert!(head.contains("\r\nContent-Length: 3\r\nAllow: GET\r\nX-A: b\r\n"), "{head}");
        assert_eq!(event(Some(4), "", "{}"), "id: 4\ndata: {}\n\n");
        assert_eq!(event(None, "end", "{}"), "event: end\ndata: {}\n\n");
    }
}
