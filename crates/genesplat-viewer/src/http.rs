//! As much of HTTP/1.1 as one page needs: a request's head, bounded in bytes and time, and an answer that
//! ends the connection.

use std::io::{self, Read, Write};

/// Longest head of a request, bytes.
const HEAD_BYTES_MAX: usize = 8192;
const HEADERS_MAX: usize = 48;

/// The page may load its own parts and nothing else, and nobody may frame it or learn its address.
const HEADERS: &str = "Connection: close\r\n\
    Cache-Control: no-store\r\n\
    X-Content-Type-Options: nosniff\r\n\
    Referrer-Policy: no-referrer\r\n\
    Cross-Origin-Opener-Policy: same-origin\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

/// Why there is no page for a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    BadRequest,
    Forbidden,
    NotFound,
    NotGet,
    TooLong,
    Busy,
    /// The run still trains.
    NotYet,
    /// A file could not be made; pages are told why.
    NotMade,
}

impl Status {
    pub(crate) fn line(self) -> &'static str {
        match self {
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::NotGet => "405 Method Not Allowed",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Busy | Self::NotMade => "503 Service Unavailable",
            Self::NotYet => "409 Conflict",
        }
    }
}

/// The head of a GET.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) path: String,
    headers: Vec<(String, String)>,
}

impl Request {
    /// The header of this name, in small letters; `None` where there are several, which no browser sends.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let mut all =
            self.headers.iter().filter(|(header, _)| header == name).map(|(_, value)| value.as_str());
        all.next().filter(|_| all.next().is_none())
    }

    pub(crate) fn is_upgrade(&self) -> bool {
        self.header("upgrade").is_some_and(|value| value.eq_ignore_ascii_case("websocket"))
    }
}

/// Reads a request from the bytes of a stranger, and returns it with the bytes that came after its head.
/// `None` where the stranger hangs up, or is slower than the stream allows.
pub(crate) fn read_request(stream: &mut impl Read) -> Result<Option<(Request, Vec<u8>)>, Status> {
    let (mut bytes, mut part) = (Vec::new(), [0; 1024]);
    loop {
        let Ok(count @ 1..) = stream.read(&mut part) else { return Ok(None) };
        bytes.extend_from_slice(&part[..count]);
        if let Some((request, end)) = parse_head(&bytes)? {
            return Ok(Some((request, bytes.split_off(end))));
        }
    }
}

/// The head that `bytes` begin with, and where it ends; `None` where more bytes are needed.
pub(crate) fn parse_head(bytes: &[u8]) -> Result<Option<(Request, usize)>, Status> {
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let end = match head.parse(bytes) {
        Ok(httparse::Status::Complete(end)) if end <= HEAD_BYTES_MAX => end,
        Ok(httparse::Status::Partial) if bytes.len() < HEAD_BYTES_MAX => return Ok(None),
        Ok(_) | Err(httparse::Error::TooManyHeaders) => return Err(Status::TooLong),
        Err(_) => return Err(Status::BadRequest),
    };
    if head.method != Some("GET") {
        return Err(Status::NotGet);
    }
    let text = |header: &httparse::Header<'_>| {
        Some((header.name.to_ascii_lowercase(), str::from_utf8(header.value).ok()?.to_owned()))
    };
    let headers = head.headers.iter().map(text).collect::<Option<_>>().ok_or(Status::BadRequest)?;
    Ok(Some((Request { path: head.path.unwrap_or_default().into(), headers }, end)))
}

pub(crate) fn respond(stream: &mut impl Write, kind: &str, body: &[u8]) -> io::Result<()> {
    write_response(stream, "200 OK", kind, body)
}

pub(crate) fn refuse(stream: &mut impl Write, status: Status) -> io::Result<()> {
    let sentence = match status {
        Status::Busy => "Too many pages are open; close one.",
        Status::Forbidden => {
            "Open the address that genesplat printed, by this machine's IP number, not by its name; \
             a name, as of a proxy or tunnel, is let in by --view-host NAME."
        }
        Status::NotYet => "The run still trains; its Snapshot button saves the splat.",
        Status::NotMade => "The file could not be made; the page says why.",
        _ => "There is nothing here. Open the whole address that genesplat printed.",
    };
    write_response(stream, status.line(), "text/plain; charset=utf-8", sentence.as_bytes())
}

fn write_response(stream: &mut impl Write, status: &str, kind: &str, body: &[u8]) -> io::Result<()> {
    stream.write_all(head(status, kind, body.len()).as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

fn head(status: &str, kind: &str, bytes: usize) -> String {
    format!("HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {bytes}\r\n{HEADERS}\r\n")
}

/// The head of a file that browsers save and never show: a page that came from here could read the token.
pub(crate) fn attachment_head(bytes: usize) -> String {
    head("200 OK", "application/octet-stream\r\nContent-Disposition: attachment", bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_read_piece_by_piece_and_bounded() {
        let head = b"GET /a/b?c HTTP/1.1\r\nHost: x\r\nUPGRADE: WebSocket\r\n\r\nrest";
        let (request, rest) = read_request(&mut &head[..]).unwrap().unwrap();
        assert_eq!(
            (request.path.as_str(), request.header("host"), request.is_upgrade()),
            ("/a/b?c", Some("x"), true)
        );
        assert_eq!(rest, b"rest");
        assert!((0..head.len() - 4).all(|end| parse_head(&head[..end]).unwrap().is_none()));
        let endless = [b"GET / HTTP/1.1\r\nA: ".as_slice(), &[b'x'; HEAD_BYTES_MAX]].concat();
        assert_eq!(read_request(&mut &endless[..]).unwrap_err(), Status::TooLong);
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "A: b\r\n".repeat(HEADERS_MAX + 1));
        assert_eq!(parse_head(many.as_bytes()).unwrap_err(), Status::TooLong);
        assert_eq!(parse_head(b"POST / HTTP/1.1\r\n\r\n").unwrap_err(), Status::NotGet);
        assert_eq!(parse_head(b"\x16\x03\x01\x02\x00").unwrap_err(), Status::BadRequest, "TLS");
        let twice = parse_head(b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n").unwrap().unwrap().0;
        assert_eq!(twice.header("host"), None);
        assert!(read_request(&mut &b"GET / HT"[..]).unwrap().is_none(), "it hung up");
    }

    #[test]
    fn who_comes_by_a_name_is_told_to_come_by_a_number() {
        let mut answer = Vec::new();
        refuse(&mut answer, Status::Forbidden).unwrap();
        assert!(
            String::from_utf8(answer)
                .unwrap()
                .ends_with("a name, as of a proxy or tunnel, is let in by --view-host NAME.")
        );
    }
}
