//! Who acts.

use std::net::IpAddr;

use forelight_protocol::{Role, TokenId};

/// Somebody who does something.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Actor {
    /// Name of the token.
    pub name: String,
    /// Role of the token.
    pub role: Role,
    /// The token.
    pub token: Option<TokenId>,
    /// Address of the connection's other end.
    pub from: Option<IpAddr>,
}
