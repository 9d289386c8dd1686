//! The cookie of a session, and requests that pages of other sites make with it.
//!
//! The hazard: a browser adds the cookie to every request to this address, whoever's page makes it. Browsers
//! leave out a `SameSite=Strict` cookie in requests from other sites. They call another port or a sibling's
//! name the same site, though. So a request that changes something must come from a page of this very origin.

use axum::http::header::{COOKIE, HOST, HeaderName, ORIGIN};
use axum::http::{HeaderMap, HeaderValue};
use forelight_protocol::ProblemKind;

use crate::error::{ApiError, ApiResult};

const NAME: &str = "forelight_session";
/// The cookie of a browser that is at the sign-in provider. It comes back from another site, so it is `Lax`.
const SIGN_IN: &str = "forelight_sign_in";
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// The session's secret in a request.
pub(crate) fn session_secret(headers: &HeaderMap) -> Option<&str> {
    cookie(headers, NAME)
}

/// The state of the sign-in that this browser began.
pub(crate) fn sign_in_state(headers: &HeaderMap) -> Option<&str> {
    cookie(headers, SIGN_IN)
}

fn cookie<'a>(headers: &'a HeaderMap, wanted: &str) -> Option<&'a str> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    cookies.flat_map(|value| value.split(';')).find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == wanted && !value.is_empty()).then_some(value)
    })
}

/// `Set-Cookie` that gives the browser a secret for so many seconds. Scripts cannot read it.
pub(crate) fn set_session(secret: &str, seconds: u64, over_tls: bool) -> ApiResult<HeaderValue> {
    set(&format!("{NAME}={secret}; HttpOnly; SameSite=Strict; Path=/"), seconds, over_tls)
}

/// `Set-Cookie` that binds a sign-in at a provider to this browser for so many seconds. 0 ends it.
pub(crate) fn set_sign_in(state: &str, seconds: u64, over_tls: bool) -> ApiResult<HeaderValue> {
    set(&format!("{SIGN_IN}={state}; HttpOnly; SameSite=Lax; Path=/v1/sign-in"), seconds, over_tls)
}

fn set(cookie: &str, seconds: u64, over_tls: bool) -> ApiResult<HeaderValue> {
    let secure = if over_tls { "; Secure" } else { "" };
    HeaderValue::from_str(&format!("{cookie}; Max-Age={seconds}{secure}"))
        .map_err(|_| ApiError::new(ProblemKind::Internal, "a cookie could not be written"))
}

/// `Set-Cookie` that makes the browser forget the secret.
pub(crate) fn forget_session(over_tls: bool) -> ApiResult<HeaderValue> {
    set_session("", 0, over_tls)
}

/// Refuses a request with a session's cookie that a page of another origin may have made. `public` is the
/// origin at which people reach the service, if it is known.
pub(crate) fn check_same_origin(headers: &HeaderMap, public: Option<&str>) -> ApiResult<()> {
    let is_same = match (headers.get(SEC_FETCH_SITE), headers.get(ORIGIN)) {
        (Some(site), _) => site == "same-origin",
        // Browsers send no `Sec-Fetch-Site` over plain HTTP, except to this machine.
        (None, Some(origin)) => {
            let origin = origin.to_str().unwrap_or_default();
            let host = headers.get(HOST).and_then(|host| host.to_str().ok());
            let authority = origin.split_once("://").map(|(_, authority)| authority);
            let is_host = authority.zip(host).is_some_and(|(one, other)| one.eq_ignore_ascii_case(other));
            is_host || public.is_some_and(|public| public.eq_ignore_ascii_case(origin))
        }
        (None, None) => false,
    };
    if is_same { Ok(()) } else { Err(refused()) }
}

/// Refuses a request that a browser says another site has made. Other clients send no such header.
pub(crate) fn check_not_cross_site(headers: &HeaderMap) -> ApiResult<()> {
    let site = headers.get(SEC_FETCH_SITE);
    if site.is_none_or(|site| site == "same-origin" || site == "none") { Ok(()) } else { Err(refused()) }
}

fn refused() -> ApiError {
    let reason = "the request comes from a page of another site; make it from the farm's own page, or send a \
                  bearer token";
    ApiError::new(ProblemKind::CrossSite, reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        let named = |&(name, value)| (HeaderName::from_static(name), HeaderValue::from_static(value));
        pairs.iter().map(named).collect()
    }

    #[test]
    fn the_secret_is_found_among_other_cookies() {
        let secret = |cookie| session_secret(&headers(&[("cookie", cookie)])).map(str::to_owned);
        assert_eq!(secret("a=b; forelight_session=s3; c=d").as_deref(), Some("s3"));
        assert_eq!(secret("forelight_session=a=b").as_deref(), Some("a=b"));
        for none in
            ["", "forelight_session", "forelight_session=", "xforelight_session=s", "a=forelight_session=s"]
        {
            assert_eq!(secret(none), None, "{none}");
        }
    }

    #[test]
    fn only_a_page_of_this_origin_may_change_something() {
        let public = Some("https://farm.example");
        let is_same = |pairs: &[_]| check_same_origin(&headers(pairs), public).is_ok();
        assert!(is_same(&[("sec-fetch-site", "same-origin"), ("origin", "https://other.example")]));
        assert!(is_same(&[("origin", "http://10.0.0.5:7878"), ("host", "10.0.0.5:7878")]));
        assert!(is_same(&[("origin", "https://farm.example"), ("host", "127.0.0.1:7878")]));
        for site in ["cross-site", "same-site", "none", ""] {
            let origin = ("origin", "http://10.0.0.5:7878");
            assert!(!is_same(&[("sec-fetch-site", site), origin, ("host", "10.0.0.5:7878")]), "{site}");
        }
        for origin in ["null", "", "http://10.0.0.5", "http://10.0.0.5:7879", "https://farm.example.evil"] {
            assert!(!is_same(&[("origin", origin), ("host", "10.0.0.5:7878")]), "{origin}");
        }
        assert!(!is_same(&[("host", "10.0.0.5:7878")]));
    }
}
