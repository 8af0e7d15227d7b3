//! Wide logs: one row per stamp, one column per anchor, empty if nothing was heard.

use std::io::Read;

use crate::recording::SensorName;
use crate::recording::anchors::Anchors;
use crate::recording::columns::layout::Finder;
use crate::recording::columns::names::Name;
use crate::recording::columns::{ColumnMap, ColumnOption, Role};
use crate::recording::error::{RecordingError, listed};
use crate::recording::table::Table;
use crate::recording::table::unit::{Unit, UnitKind};

/// Words besides an anchor's name in the name of its column of ranges.
const WORDS: [&str; 18] = [
    "range", "ranges", "r", "distance", "dist", "d", "to", "anchor", "anc", "a", "an", "beacon", "b", "node", "sensor",
    "station", "uwb", "ap",
];

/// The column of one anchor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AnchorColumn {
    pub(super) index: usize,
    pub(super) anchor: SensorName,
    pub(super) unit: Unit,
}

/// True if a column has the ranges of one of the anchors.
pub(super) fn is_of_anchor(column: &str, anchors: &Anchors, map: &ColumnMap) -> bool {
    anchors.iter().any(|(anchor, _)| fit(column, anchor.as_str(), pattern(map)).is_some())
}

/// The user's pattern for the names of the anchors' columns, with `*` for the anchor.
pub(super) fn pattern(map: &ColumnMap) -> Option<&ColumnOption> {
    map.get(Role::Range).filter(|option| option.column.contains('*'))
}

/// How well a column fits an anchor: 0 is best.
fn fit(column: &str, anchor: &str, pattern: Option<&ColumnOption>) -> Option<usize> {
    match pattern.map(|option| option.column.as_str()) {
        None | Some("*") => fit_by_words(column, anchor),
        Some(pattern) => pattern.replacen('*', anchor, 1).eq_ignore_ascii_case(column.trim()).then_some(0),
    }
}

fn fit_by_words(column: &str, anchor: &str) -> Option<usize> {
    if column.trim().eq_ignore_ascii_case(anchor) {
        return Some(0);
    }
    let column = Name::read(column);
    let anchor = anchor.to_lowercase();
    let anchor_words = Name::read(&anchor).words;
    let is_angle = column.unit.is_some_and(|unit| unit.kind() == UnitKind::Angle);
    if anchor_words.is_empty() || column.words.is_empty() || is_angle {
        return None;
    }
    let is_other = |word: &String| WORDS.contains(&word.as_str());
    if column.words.len() >= anchor_words.len() {
        for start in 0..=column.words.len() - anchor_words.len() {
            let (before, rest) = column.words.split_at(start);
            let (name, after) = rest.split_at(anchor_words.len());
            if name == anchor_words && before.iter().chain(after).all(is_other) {
                return Some(column.words.len() - anchor_words.len() + 1);
            }
        }
    }
    // `d1`, `anchor3`.
    let joined = column.words.last().and_then(|last| last.strip_suffix(anchor.as_str()));
    let is_joined = anchor.starts_with(|c: char| c.is_ascii_digit())
        && joined.is_some_and(|word| WORDS.contains(&word))
        && column.words[..column.words.len() - 1].iter().all(is_other);
    is_joined.then_some(column.words.len() + 1)
}

/// The anchors' columns; empty if the log is not a wide one.
pub(super) fn anchor_columns<R: Read>(
    finder: &mut Finder<'_>,
    table: &Table<R>,
    anchors: &Anchors,
    map: &ColumnMap,
) -> Result<Vec<AnchorColumn>, RecordingError> {
    let pattern = pattern(map);
    let header = finder.header().to_vec();
    let (mut columns, mut has_unknown_unit) = (Vec::new(), false);
    let mut used = vec![false; header.len()];
    for (anchor, _) in anchors.iter() {
        let fits = |(index, column): (usize, &String)| {
            (!finder.is_used(index)).then(|| fit(column, anchor.as_str(), pattern)).flatten().map(|fit| (fit, index))
        };
        let fits: Vec<(usize, usize)> = header.iter().enumerate().filter_map(fits).collect();
        let Some(&(best, index)) = fits.iter().min() else { continue };
        let rivals: Vec<&str> =
            fits.iter().filter(|(fit, _)| *fit == best).map(|(_, index)| header[*index].as_str()).collect();
        if rivals.len() > 1 || used[index] {
            return Err(table.header_error(
                format!("several columns, {}, that may have the ranges of anchor \"{anchor}\",", listed(rivals)),
                "give the pattern of the columns, with * for the anchor's name, as in --columns 'range=range_*:m'",
            ));
        }
        used[index] = true;
        let unit = pattern
            .and_then(|option| option.unit)
            .or_else(|| Name::read(&header[index]).unit.filter(|unit| Role::Range.takes(*unit)));
        has_unknown_unit |= unit.is_none();
        columns.push(AnchorColumn { index, anchor: anchor.clone(), unit: unit.unwrap_or(Unit::Metre) });
    }
    if columns.is_empty() {
        return Ok(columns);
    }
    if has_unknown_unit {
        let column = pattern.map_or("*", |option| &option.column).to_owned();
        finder.ask(ColumnOption { role: Role::Range, column, unit: Some(Unit::Metre) });
    }
    for column in &columns {
        finder.take(Role::Range, column.index, Some(column.unit));
    }
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_called_after_their_anchor() {
        for (column, anchor) in [
            ("A", "a"),
            ("range_A", "A"),
            ("A_m", "A"),
            ("anchor_3 (mm)", "3"),
            ("d1", "1"),
            ("dist.to.anchor-3", "anchor-3"),
            ("5C:F3:70:8B:12:AE (m)", "5c:f3:70:8b:12:ae"),
        ] {
            assert!(fit_by_words(column, anchor).is_some(), "{column} {anchor}");
        }
        for (column, anchor) in
            [("rssi_A", "A"), ("los_3", "3"), ("range_11", "1"), ("d11", "1"), ("B", "A"), ("", "A"), ("A_deg", "A")]
        {
            assert!(fit_by_words(column, anchor).is_none(), "{column} {anchor}");
        }
    }
}
