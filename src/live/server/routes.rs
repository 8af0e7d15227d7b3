//! Requests and their answers.
//!
//! | request | answer | token |
//! |---|---|---|
//! | `GET /?token=T` | the page | in the address, from which the page removes it |
//! | `GET /T/FILE` | a file of the page | in the address |
//! | `GET /stream?token=T` | the page's contents, as server-sent events | in the address |
//! | `POST /act/ACTION/NODE` | acts on the node | in a header |

use std::sync::Arc;

use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{Method, StatusCode};
use axum::middleware::from_fn_with_state;
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use serde::Deserialize;

use super::assets;
use super::guard::{self, ActPermission, ViewPermission, refuse};
use super::shared::Shared;
use super::stream;
use crate::live::act::{Action, Refused};

/// All routes, with the guard before them.
pub(super) fn router(shared: &Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(page))
        .route("/stream", get(stream::open))
        .route("/refused.js", get(([(CONTENT_TYPE, assets::SCRIPT)], assets::REFUSED_SCRIPT)))
        .route("/{token}/{file}", get(file))
        .route("/act/{action}/{node}", post(act))
        .route("/act/{action}/", post(act))
        .fallback(other)
        .method_not_allowed_fallback(other)
        .layer(from_fn_with_state(Arc::clone(shared), guard::guard))
        .with_state(Arc::clone(shared))
}

async fn page(ViewPermission(shared): ViewPermission) -> Html<String> {
    Html(assets::PAGE.replace("{token}", &shared.token.to_string()))
}

async fn file(
    State(shared): State<Arc<Shared>>,
    path: Result<Path<(String, String)>, PathRejection>,
) -> Result<Response, impl IntoResponse> {
    // A client without the token must not learn which files exist.
    let Some(Path((_, file))) = path.ok().filter(|Path((token, _))| shared.token.is(token)) else {
        return Err(refuse());
    };
    Ok(match assets::of(&file) {
        Some((text, kind)) => ([(CONTENT_TYPE, kind)], text).into_response(),
        None => (StatusCode::NOT_FOUND, "The page has no such file.").into_response(),
    })
}

/// An action and its node.
#[derive(Deserialize)]
struct Asked {
    action: String,
    /// Empty if the path has no node.
    #[serde(default)]
    node: String,
}

async fn act(ActPermission(shared): ActPermission, Path(Asked { action, node }): Path<Asked>) -> (StatusCode, String) {
    let Some(action) = Action::from_name(&action) else {
        return (StatusCode::BAD_REQUEST, "Unknown action: expected kill, stop, continue or restart.".to_owned());
    };
    let Some(run) = &shared.run else {
        return (StatusCode::CONFLICT, "A recording has no processes.".to_owned());
    };
    match action.on(run, &node) {
        Ok(done) => (StatusCode::OK, done),
        Err(Refused::Nonsense(problem)) => (StatusCode::BAD_REQUEST, problem),
        Err(Refused::NotNow(problem)) => (StatusCode::CONFLICT, problem),
    }
}

/// The answer for an unknown path or method.
async fn other(method: Method) -> Response {
    match method {
        Method::GET => refuse().into_response(),
        _ => (
            StatusCode::METHOD_NOT_ALLOWED,
            "This method is not supported here: expected GET, or POST to /act/ACTION/NODE.",
        )
            .into_response(),
    }
}
