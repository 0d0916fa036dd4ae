//! Who is let in: whoever knows the token of the address, and whose Host and Origin are ours.
//!
//! A token alone would keep strangers out, but addresses end up in histories. A server on loopback can be
//! reached by any page that the user has open, under a name that its owner points at 127.0.0.1 (DNS
//! rebinding): such a page sends its own name as Host, which is not on the list.

use std::net::{IpAddr, SocketAddr};

use crate::ViewerError;
use crate::http::{Request, Status};

const TOKEN_BYTES: usize = 16;

/// Where a page is served, and by what names it is reached.
#[derive(Clone, Debug)]
pub struct Address {
    /// What is listened on; port 0 takes any that is free.
    pub socket: SocketAddr,
    /// Names of proxies and tunnels in front of it, which lead here by the user's own word.
    pub hosts: Vec<String>,
}

impl From<SocketAddr> for Address {
    fn from(socket: SocketAddr) -> Self {
        Self { socket, hosts: Vec::new() }
    }
}

pub(crate) struct Gate {
    token: String,
    /// What the server listens on.
    address: IpAddr,
    /// Names that are let in besides.
    hosts: Vec<String>,
}

impl Gate {
    pub(crate) fn new(address: IpAddr, hosts: Vec<String>) -> Result<Self, ViewerError> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes).map_err(|error| ViewerError::Random(error.to_string()))?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { hosts, ..Self::with_token(token, address) })
    }

    pub(crate) fn with_token(token: String, address: IpAddr) -> Self {
        Self { token, address, hosts: Vec::new() }
    }

    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// The path below the token, of a request that may be answered. Whoever opens a socket must say its
    /// origin.
    pub(crate) fn admit<'a>(&self, request: &'a Request) -> Result<&'a str, Status> {
        let host = request.header("host").ok_or(Status::BadRequest)?;
        let origin = request.header("origin");
        let is_known = origin.map_or(!request.is_upgrade(), |origin| self.is_origin(origin, host));
        if !self.is_host(host) || !is_known {
            return Err(Status::Forbidden);
        }
        let (token, path) =
            request.path.strip_prefix('/').and_then(|rest| rest.split_once('/')).ok_or(Status::NotFound)?;
        if is_equal(token.as_bytes(), self.token.as_bytes()) { Ok(path) } else { Err(Status::NotFound) }
    }

    /// A page of the host that was asked, or of a name that is let in: proxies may ask by our number, and
    /// speak TLS to the browser.
    fn is_origin(&self, origin: &str, host: &str) -> bool {
        let origin = origin.to_ascii_lowercase();
        let Some((scheme, place)) = origin.split_once("://") else { return false };
        let is_same = scheme == "http" && place.eq_ignore_ascii_case(host);
        is_same || (["http", "https"].contains(&scheme) && self.is_let_in(without_port(place)))
    }

    fn is_let_in(&self, name: &str) -> bool {
        self.hosts.iter().any(|host| host.eq_ignore_ascii_case(name))
    }

    /// Ports differ where ssh forwards one to another, so any is right.
    fn is_host(&self, host: &str) -> bool {
        let name = without_port(host);
        if self.is_let_in(name) {
            return true;
        }
        let is_near = self.address.is_loopback() || self.address.is_unspecified();
        if name.eq_ignore_ascii_case("localhost") {
            return is_near;
        }
        let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
        // A number is no name, so nobody else can point it here.
        bare.parse::<IpAddr>().is_ok_and(|number| {
            number == self.address || self.address.is_unspecified() || (is_near && number.is_loopback())
        })
    }
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    }
}

/// Takes as long wherever the first difference is.
fn is_equal(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |difference, (a, b)| difference | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::parse_head;

    fn answer(gate: &Gate, path: &str, headers: &str) -> Result<String, Status> {
        let head = format!("GET {path} HTTP/1.1\r\n{headers}\r\n");
        let (request, _) = parse_head(head.as_bytes()).unwrap().expect("a whole head");
        gate.admit(&request).map(str::to_owned)
    }

    #[test]
    fn only_ours_is_let_in() {
        let gate = Gate::new([127, 0, 0, 1].into(), Vec::new()).unwrap();
        let page = format!("/{}/main.js", gate.token);
        let get = |path: &str, headers: &str| answer(&gate, path, headers);
        for host in ["127.0.0.1:7007", "localhost:9", "LOCALHOST", "[::1]:80", "127.0.0.2"] {
            assert_eq!(get(&page, &format!("Host: {host}\r\n")), Ok("main.js".into()), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:7007",
            "127.0.0.1.evil.example",
            "192.168.1.4",
            "",
            "localhost.x:1",
        ] {
            assert_eq!(get(&page, &format!("Host: {host}\r\n")), Err(Status::Forbidden), "{host}");
        }
        assert_eq!(get(&page, ""), Err(Status::BadRequest));
        let host = "Host: localhost:7007\r\n";
        for origin in ["http://evil.example", "null", "http://localhost:1", "https://localhost:7007"] {
            assert_eq!(
                get(&page, &format!("{host}Origin: {origin}\r\n")),
                Err(Status::Forbidden),
                "{origin}"
            );
        }
        assert!(get(&page, &format!("{host}Origin: http://localhost:7007\r\n")).is_ok());
        assert_eq!(get(&page, &format!("{host}Upgrade: websocket\r\n")), Err(Status::Forbidden), "no origin");
        for path in ["/", "/main.js", "//main.js", "/00000000000000000000000000000000/main.js", "*"] {
            assert_eq!(get(path, host), Err(Status::NotFound), "{path}");
        }
        assert_ne!(gate.token, Gate::new([127, 0, 0, 1].into(), Vec::new()).unwrap().token);
    }

    #[test]
    fn another_address_has_its_own_host() {
        let gate = Gate::new([192, 168, 1, 4].into(), Vec::new()).unwrap();
        assert!(gate.is_host("192.168.1.4:80") && !gate.is_host("localhost") && !gate.is_host("192.168.1.5"));
        let any = Gate::new([0, 0, 0, 0].into(), Vec::new()).unwrap();
        assert!(any.is_host("10.0.0.7:1") && any.is_host("localhost") && !any.is_host("box.example"));
    }

    #[test]
    fn a_name_that_the_user_gives_is_let_in_with_tls_and_no_other() {
        let gate = Gate::new([127, 0, 0, 1].into(), vec!["splats.example".into()]).unwrap();
        let page = format!("/{}/socket", gate.token);
        let get = |host: &str, origin: &str| {
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            answer(&gate, &page, &format!("Host: {host}\r\n{origin}")).is_ok()
        };
        // As a tunnel asks, and as a proxy does that asks by our number.
        for host in ["splats.example", "SPLATS.example:8443", "127.0.0.1:7007"] {
            for origin in
                ["", "https://splats.example", "https://Splats.Example:8443", "http://splats.example"]
            {
                assert!(get(host, origin), "{host} {origin}");
            }
        }
        for origin in [
            "https://evil.example",
            "https://splats.example.evil",
            "https://x.splats.example",
            "ftp://splats.example",
            "https://evil.example/splats.example",
            "https://127.0.0.1:7007",
            "null",
        ] {
            assert!(!get("splats.example", origin) && !get("127.0.0.1:7007", origin), "{origin}");
        }
        for host in ["evil.example", "x.splats.example", "splats.example.", "splats.example:x"] {
            assert!(!get(host, ""), "{host}");
        }
    }
}
