//! Access control: only this user on this machine, from the page itself.
//!
//! | against | rule |
//! |---|---|
//! | other machines | bound to 127.0.0.1 |
//! | other users of this machine | a random token, stored only in the run folder and shown only on the terminal |
//! | names that resolve to this machine (DNS rebinding) | `Host` is 127.0.0.1 or localhost with this port |
//! | other pages in the same browser | `Origin`, if present, is this page's; actions need the token in a header, which no form can set |

use std::sync::Arc;

use axum::extract::{FromRequestParts, Request, State};
use axum::http::header::{self, HeaderName, HeaderValue};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{Html, IntoResponse, Response};

use super::assets;
use super::shared::Shared;

/// Header of the token of an action.
const TOKEN_HEADER: &str = "x-rangehound-token";

/// Headers of every answer: no caching, no content from elsewhere, no display in another page's frame.
const ANSWER_HEADERS: [(HeaderName, &str); 7] = [
    (header::CACHE_CONTROL, "no-store"),
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// True if the request names this server as its host, and comes from its own page if from any.
pub(super) fn is_from_here(headers: &HeaderMap, port: u16) -> bool {
    let hosts = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    let only = |name: HeaderName| {
        let mut values = headers.get_all(name).iter();
        (values.next(), values.next().is_none())
    };
    let (host, is_only_host) = only(header::HOST);
    let (origin, is_only_origin) = only(header::ORIGIN);
    let is_ours = |value: &HeaderValue, scheme: &str| {
        value.to_str().is_ok_and(|value| value.strip_prefix(scheme).is_some_and(|host| hosts.iter().any(|h| h == host)))
    };
    is_only_host
        && is_only_origin
        && host.is_some_and(|host| is_ours(host, ""))
        && origin.is_none_or(|origin| is_ours(origin, "http://"))
}

/// The answer to a request that [`is_from_here`] refuses: most such requests come through a tunnel from another port.
pub(super) fn where_from_here(port: u16) -> String {
    format!(
        "This page is for this machine only, at http://127.0.0.1:{port}/ or http://localhost:{port}/. Through a tunnel, use the \
         same port at both ends: ssh -L {port}:127.0.0.1:{port} HOST. If that port is taken, choose another with --live=PORT \
         (rangehound live: --port PORT).\n"
    )
}

/// Admits requests that pass [`is_from_here`], and sets the headers of every answer.
pub(super) async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let answer = if is_from_here(request.headers(), shared.port) {
        next.run(request).await
    } else {
        (StatusCode::FORBIDDEN, where_from_here(shared.port)).into_response()
    };
    (ANSWER_HEADERS, answer).into_response()
}

/// A viewer: the token is in the address.
pub(super) struct ViewPermission(pub(super) Arc<Shared>);

impl FromRequestParts<Arc<Shared>> for ViewPermission {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, shared: &Arc<Shared>) -> Result<Self, Refusal> {
        let query = parts.uri.query().unwrap_or_default();
        let mut tokens = query.split('&').filter_map(|pair| pair.strip_prefix("token="));
        if tokens.any(|text| shared.token.is(text)) { Ok(Self(Arc::clone(shared))) } else { Err(refuse()) }
    }
}

/// A client that may act: the token is in a header.
pub(super) struct ActPermission(pub(super) Arc<Shared>);

impl FromRequestParts<Arc<Shared>> for ActPermission {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, shared: &Arc<Shared>) -> Result<Self, Refusal> {
        let token = parts.headers.get(TOKEN_HEADER).and_then(|value| value.to_str().ok());
        if token.is_some_and(|text| shared.token.is(text)) { Ok(Self(Arc::clone(shared))) } else { Err(refuse()) }
    }
}

type Refusal = (StatusCode, Html<&'static str>);

/// The answer to a request without the token.
pub(super) fn refuse() -> Refusal {
    (StatusCode::FORBIDDEN, Html(assets::REFUSED))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, HeaderValue::from_static(value));
        }
        headers
    }

    #[test]
    fn only_this_server_by_name_and_its_own_page_are_let_in() {
        for good in [
            &[("host", "127.0.0.1:80")][..],
            &[("host", "localhost:80")],
            &[("host", "127.0.0.1:80"), ("origin", "http://127.0.0.1:80")],
        ] {
            assert!(is_from_here(&headers(good), 80), "{good:?}");
        }
        for bad in [
            &[][..],
            &[("host", "127.0.0.1")],
            &[("host", "127.0.0.1:81")],
            &[("host", "evil.example:80")],
            &[("host", "127.0.0.1:80"), ("host", "127.0.0.1:80")],
            &[("host", "127.0.0.1:80"), ("origin", "null")],
            &[("host", "127.0.0.1:80"), ("origin", "https://127.0.0.1:80")],
            &[("host", "127.0.0.1:80"), ("origin", "http://127.0.0.1:81")],
            &[("host", "127.0.0.1:80"), ("origin", "http://127.0.0.1:80"), ("origin", "http://evil.example")],
        ] {
            assert!(!is_from_here(&headers(bad), 80), "{bad:?}");
        }
    }
}
