//! The live page: whoever trains looks at the splat meanwhile, in a browser, over one WebSocket. And a page
//! to send.
//!
//! The device that trains renders, and the page shows JPEG pictures, so that a laptop sees over ssh exactly
//! what is trained. Nothing here makes training wait but the pictures themselves, which keep to a [`Budget`].
//!
//! | part | what it is |
//! |---|---|
//! | [`LiveView`] | the page of one run: its state, its curves, and the pictures that are due between two steps |
//! | [`message`] | what page and server say to each other |
//! | [`edit`] | which Gaussians a box or a brush removes, and how that is undone |
//! | [`render_mode`] | depth, counts, points and ellipses, each as a cloud that an ordinary renderer shows |
//! | [`path`] | camera paths, for animations |
//! | [`standalone`] | a page to send: one file that holds the splat and draws it by itself |
//! | `hub` | slots that hold the newest only, between the threads of the pages and the one that renders |
//! | `server` | threads, time-outs, and caps on all that a stranger can make grow |
//! | `places` | how many connections there may be, of strangers and of those who have shown the token |
//! | `gate` | who is let in: the token of the address, Host and Origin |
//! | `downloads` | the splat and the page to send, made when a page asks for them |
//!
//! The server reads no file: pages are part of the program, photos are in memory.

mod budget;
#[doc(hidden)]
pub mod bytes;
mod clock;
mod curves;
mod downloads;
pub mod edit;
mod framing;
mod gate;
mod http;
mod hub;
mod live;
pub mod message;
mod page;
pub mod path;
mod picture;
mod places;
pub mod render_mode;
mod scene_views;
mod server;
mod socket;
pub mod standalone;

pub use budget::Budget;
pub use downloads::Download;
pub use framing::Framing;
pub use gate::Address;
pub use live::{Keeper, LiveView, Owner, Phase};
pub use scene_views::{SceneViews, Split};

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// The address cannot be listened on.
    #[error(
        "the page cannot be served at {address}: {source}; choose another --view-address, or leave it out"
    )]
    Listen {
        /// What was asked for.
        address: std::net::SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The system has no random bytes for the token.
    #[error("the system gives no random numbers for the page's address: {0}")]
    Random(String),
}
