//! The files of the page, built into the program: no network or folder is needed.

/// The page. `{token}` in it is the folder of the other files.
pub(super) const PAGE: &str = include_str!("page/index.html");

/// The page for a request without the token; a browser that has the token sends the request again with it.
pub(super) const REFUSED: &str = include_str!("page/refused.html");

/// The script of that page; it needs no token.
pub(super) const REFUSED_SCRIPT: &str = include_str!("page/refused.js");

pub(super) const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

/// The file of this name with its type.
pub(super) fn of(name: &str) -> Option<(&'static str, &'static str)> {
    Some(match name {
        "style.css" => (include_str!("page/style.css"), STYLE),
        "live.js" => (include_str!("page/live.js"), SCRIPT),
        "field.js" => (include_str!("page/field.js"), SCRIPT),
        "charts.js" => (include_str!("page/charts.js"), SCRIPT),
        "figures.js" => (include_str!("page/figures.js"), SCRIPT),
        "view.js" => (include_str!("page/view.js"), SCRIPT),
        "nodes.js" => (include_str!("page/nodes.js"), SCRIPT),
        _ => return None,
    })
}
