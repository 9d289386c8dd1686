//! Keyset pagination.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Position of the next page. Opaque: clients send it back unchanged as `page_token`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(transparent)]
#[schema(value_type = String)]
pub struct PageToken(pub String);

impl fmt::Display for PageToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
