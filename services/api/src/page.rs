//! Paging by key: a token holds the key after which the next page starts. No item is skipped or repeated.

use forelight_protocol::{PageToken, ProblemKind};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use crate::error::{ApiError, ApiResult};
use crate::extract::number_if_any;

const DEFAULT_SIZE: u32 = 50;

/// Most items on a page.
pub(crate) const LARGEST_PAGE: i64 = 200;

#[derive(Clone, Debug, Default, Deserialize, IntoParams, ToSchema)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct PageQuery {
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

impl PageQuery {
    pub fn size(&self) -> u32 {
        self.page_size.unwrap_or(DEFAULT_SIZE)
    }

    /// The key after which the page starts. A token made for another `list` is refused.
    pub fn key<K: DeserializeOwned>(&self, list: &str) -> ApiResult<Option<K>> {
        let Some(token) = &self.page_token else { return Ok(None) };
        let refused = || {
            ApiError::new(ProblemKind::Invalid, "this is not a page token of this list")
                .in_parameter("page_token")
        };
        let bytes = from_hex(token).ok_or_else(refused)?;
        let (of, key): (String, K) = serde_json::from_slice(&bytes).map_err(|_| refused())?;
        if of == list { Ok(Some(key)) } else { Err(refused()) }
    }
}

/// Cuts a list read with one item more than the page size, which only shows that there is a next page.
pub(crate) fn cut<T, K: Serialize>(
    items: &mut Vec<T>,
    size: u32,
    list: &str,
    key: impl Fn(&T) -> K,
) -> Option<PageToken> {
    let size = size as usize;
    if items.len() <= size {
        return None;
    }
    items.truncate(size);
    let json = serde_json::to_string(&(list, key(items.last()?))).ok()?;
    Some(PageToken(json.bytes().map(|byte| format!("{byte:02x}")).collect()))
}

/// Longest token. The longest names of jobs fit: 200 characters of four bytes.
const LONGEST: usize = 4096;

fn from_hex(text: &str) -> Option<Vec<u8>> {
    if !text.len().is_multiple_of(2)
        || text.len() > LONGEST
        || !text.bytes().all(|byte| byte.is_ascii_hexdigit())
    {
        return None;
    }
    (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_leads_back_to_its_key_and_only_in_its_own_list() {
        let mut items = vec![1, 2, 3];
        let token = cut(&mut items, 2, "frames", |&item| item).unwrap();
        assert_eq!(items, [1, 2]);
        let query = |token: &str| PageQuery { page_token: Some(token.to_owned()), page_size: None };
        assert_eq!(query(&token.0).key::<i32>("frames").ok().flatten(), Some(2));
        assert!(query(&token.0).key::<i32>("jobs").is_err());
        let long = "名".repeat(200);
        let token = cut(&mut vec![long.clone(), long.clone()], 1, "jobs", Clone::clone).unwrap();
        assert_eq!(query(&token.0).key::<String>("jobs").ok().flatten(), Some(long));
        for broken in ["", "zz", "é", "7", &"00".repeat(2100)] {
            assert!(query(broken).key::<i32>("frames").is_err(), "{broken}");
        }
        assert!(cut(&mut items, 2, "frames", |&item| item).is_none());
    }
}
