//! What is answered to which request.
//!
//! | request | answer | token |
//! |---|---|---|
//! | `GET /?token=T` | the page | in the address, which the page takes it out of |
//! | `GET /T/FILE` | a file of the page | in the address |
//! | `GET /stream?token=T` | what the page shows, as server-sent events | in the address |
//! | `POST /act/ACTION/NODE` | does it | in a header |

use std::sync::Arc;

use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::{Method, Request, Response, StatusCode};

use super::act::{Action, Refused};
use super::assets;
use super::guard::{self, TOKEN_HEADER, is_from_here, protect};
use super::shared::Shared;
use super::stream::{self, Body, Life};

const TEXT: &str = "text/plain; charset=utf-8";

/// The answer to a request.
pub(super) fn answer(request: &Request<Incoming>, shared: &Arc<Shared>, life: &Arc<Life>) -> Response<Body> {
    let mut response = route(request, shared, life);
    protect(response.headers_mut());
    response
}

fn route(request: &Request<Incoming>, shared: &Arc<Shared>, life: &Arc<Life>) -> Response<Body> {
    if !is_from_here(request.headers(), shared.port) {
        return say(StatusCode::FORBIDDEN, guard::where_from_here(shared.port));
    }
    let path = request.uri().path();
    let mut parts = path.split('/').skip(1);
    let parts = [parts.next(), parts.next(), parts.next(), parts.next()];
    let has_token = || {
        let query = request.uri().query().unwrap_or_default();
        query.split('&').filter_map(|pair| pair.strip_prefix("token=")).any(|text| shared.token.is(text))
    };
    match (request.method(), parts) {
        (&Method::POST, [Some("act"), Some(action), Some(node), None]) => {
            let token = request.headers().get(TOKEN_HEADER).and_then(|value| value.to_str().ok());
            if token.is_some_and(|text| shared.token.is(text)) { act(action, node, shared) } else { refuse() }
        }
        (&Method::GET, [Some(""), None, ..]) if has_token() => {
            let page = assets::PAGE.replace("{token}", &shared.token.to_string());
            full(StatusCode::OK, assets::HTML, Bytes::from(page))
        }
        (&Method::GET, [Some("stream"), None, ..]) if has_token() => stream::open(shared, life)
            .unwrap_or_else(|| say(StatusCode::SERVICE_UNAVAILABLE, "Too many viewers: close another one.")),
        (&Method::GET, [Some("refused.js"), None, ..]) => {
            full(StatusCode::OK, assets::SCRIPT, Bytes::from_static(assets::REFUSED_SCRIPT.as_bytes()))
        }
        (&Method::GET, [Some(token), Some(file), None, _]) if shared.token.is(token) => match assets::of(file) {
            Some((text, kind)) => full(StatusCode::OK, kind, Bytes::from_static(text.as_bytes())),
            None => say(StatusCode::NOT_FOUND, "There is no such file."),
        },
        // Whether something is there is not told to who may not see it.
        (&Method::GET, _) => refuse(),
        _ => say(StatusCode::METHOD_NOT_ALLOWED, "Expected GET, or POST to /act/ACTION/NODE."),
    }
}

fn act(action: &str, node: &str, shared: &Shared) -> Response<Body> {
    let Some(action) = Action::from_name(action) else {
        return say(StatusCode::BAD_REQUEST, "Expected kill, stop, continue or restart.");
    };
    let Some(run) = &shared.run else {
        return say(StatusCode::CONFLICT, "A recording has no processes.");
    };
    match action.on(run, node) {
        Ok(done) => say(StatusCode::OK, done),
        Err(Refused::Nonsense(problem)) => say(StatusCode::BAD_REQUEST, problem),
        Err(Refused::NotNow(problem)) => say(StatusCode::CONFLICT, problem),
    }
}

fn refuse() -> Response<Body> {
    full(StatusCode::FORBIDDEN, assets::HTML, Bytes::from_static(assets::REFUSED.as_bytes()))
}

fn say(status: StatusCode, text: impl Into<Bytes>) -> Response<Body> {
    full(status, TEXT, text.into())
}

fn full(status: StatusCode, kind: &'static str, bytes: Bytes) -> Response<Body> {
    let mut response = Response::new(Body::Whole(Some(bytes)));
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}
