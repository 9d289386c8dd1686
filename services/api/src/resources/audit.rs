//! The audit: who did what, when, and from where.

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use forelight_protocol::{AuditAction, AuditEntry, AuditPage, Timestamp};
use forelight_store::{AuditFilter, Store, StoreError};
use futures::stream;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::responses::tagged;
use crate::error::{ApiResult, Problems};
use crate::extract::{Operator, QueryParameters, number_if_any};
use crate::page::{LARGEST_PAGE, PageQuery, cut};
use crate::schema::FileContent;
use crate::state::App;

/// Entries that are read at once for an export.
const BATCH: u32 = 500;

/// Which entries to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct AuditQuery {
    /// Only what this person or service did, by the name of the token.
    pub actor: Option<String>,
    /// Only this action.
    pub action: Option<AuditAction>,
    /// Only what was done with this: the id of a job, node or token, or the name of a project.
    pub target: Option<String>,
    /// Only what concerns this project.
    pub project: Option<String>,
    /// Only what was done at this instant or later.
    #[param(value_type = Option<String>, format = DateTime)]
    pub from: Option<Timestamp>,
    /// Only what was done before this instant.
    #[param(value_type = Option<String>, format = DateTime)]
    pub to: Option<Timestamp>,
    /// `next_page_token` of the previous page.
    pub page_token: Option<String>,
    /// Number of items on a page: 1 to 200, default 50.
    #[param(minimum = 1, maximum = 200, default = 50)]
    #[serde(default, deserialize_with = "number_if_any::<_, _, 1, LARGEST_PAGE>")]
    pub page_size: Option<u32>,
}

/// Who submitted, cancelled, changed or ordered what, newest first. Entries never change.
#[utoipa::path(get, path = "/v1/audit", operation_id = "audit_list", tag = "people", params(AuditQuery),
    responses((status = 200, description = "A page of entries", body = AuditPage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    _: Operator,
    QueryParameters(query): QueryParameters<AuditQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let AuditQuery { actor, action, target, project, from, to, page_token, page_size } = query;
    let page = PageQuery { page_token, page_size };
    let filter = AuditFilter { actor, action, target, project, from, to };
    let size = page.size();
    let mut items = app.store.audit(&filter, page.key("audit")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "audit", |entry| entry.id);
    tagged(&headers, &AuditPage { items, next_page_token })
}

/// The form of an export.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ExportFormat {
    /// One entry a line, as JSON.
    #[default]
    Ndjson,
    /// Comma-separated values (RFC 4180) with a line of names.
    Csv,
}

/// Which entries to export, and how.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportQuery {
    /// The form. Default: `ndjson`.
    #[param(inline)]
    pub format: Option<ExportFormat>,
    /// Only what was done at this instant or later.
    #[param(value_type = Option<String>, format = DateTime)]
    pub from: Option<Timestamp>,
    /// Only what was done before this instant.
    #[param(value_type = Option<String>, format = DateTime)]
    pub to: Option<Timestamp>,
}

/// All entries, oldest first, as a file.
#[utoipa::path(get, path = "/v1/audit/export", operation_id = "audit_export", tag = "people",
    params(ExportQuery),
    responses((status = 200, description = "The entries", content(
        (inline(FileContent) = "application/x-ndjson"), (inline(String) = "text/csv"))), Problems))]
pub(crate) async fn export(
    State(app): State<App>,
    _: Operator,
    QueryParameters(query): QueryParameters<ExportQuery>,
) -> ApiResult<Response> {
    let format = query.format.unwrap_or_default();
    let filter = AuditFilter { from: query.from, to: query.to, ..AuditFilter::default() };
    let (media_type, name) = match format {
        ExportFormat::Ndjson => ("application/x-ndjson", "attachment; filename=\"audit.ndjson\""),
        ExportFormat::Csv => ("text/csv; charset=utf-8", "attachment; filename=\"audit.csv\""),
    };
    let headers = [(CONTENT_TYPE, media_type), (CONTENT_DISPOSITION, name)];
    Ok((headers, Body::from_stream(lines(app.store, filter, format))).into_response())
}

fn lines(
    store: Store,
    filter: AuditFilter,
    format: ExportFormat,
) -> impl futures::Stream<Item = Result<Bytes, StoreError>> {
    stream::unfold(Some((store, filter, None)), move |state| async move {
        let (store, filter, after) = state?;
        let batch = match store.audit_after(&filter, after.unwrap_or(0), BATCH).await {
            Ok(batch) => batch,
            Err(error) => return Some((Err(error), None)),
        };
        let next = batch.last().map(|entry| entry.id).filter(|_| batch.len() == BATCH as usize);
        let text = match format {
            ExportFormat::Ndjson => batch.iter().map(as_json).collect(),
            ExportFormat::Csv => as_csv(&batch, after.is_none()),
        };
        Some((Ok(Bytes::from(text)), next.map(|next| (store, filter, Some(next)))))
    })
}

fn as_json(entry: &AuditEntry) -> String {
    // Strings and numbers always have a JSON form.
    serde_json::to_string(entry).unwrap_or_default() + "\n"
}

const COLUMNS: [&str; 10] =
    ["id", "at", "actor", "role", "token_id", "from", "action", "target", "project", "detail"];

fn as_csv(entries: &[AuditEntry], with_names: bool) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let names = with_names.then(|| COLUMNS.map(str::to_owned));
    for row in names.into_iter().chain(entries.iter().map(columns)) {
        // Writing to memory does not fail, and all rows are equally long.
        let _ = writer.write_record(row.map(inert));
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

fn columns(entry: &AuditEntry) -> [String; 10] {
    let text = |value: Option<&dyn std::fmt::Display>| value.map_or(String::new(), |it| it.to_string());
    [
        entry.id.to_string(),
        entry.at.to_string(),
        entry.actor.clone(),
        text(entry.role.as_ref().map(|it| it as _)),
        text(entry.token_id.as_ref().map(|it| it as _)),
        text(entry.from.as_ref().map(|it| it as _)),
        entry.action.to_string(),
        entry.target.clone(),
        text(entry.project.as_ref().map(|it| it as _)),
        text(entry.detail.as_ref().map(|it| it as _)),
    ]
}

/// A field that a spreadsheet would take for a formula begins with an apostrophe (OWASP, CSV injection).
fn inert(field: String) -> String {
    if field.starts_with(['=', '+', '-', '@', '\t', '\r']) { format!("'{field}") } else { field }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::Role;

    #[test]
    fn a_csv_quotes_what_has_to_be_quoted_and_holds_no_formulas() {
        let entry = AuditEntry {
            id: 7,
            at: Timestamp::from_micros(0),
            actor: "=cmd|' /C calc'!A0".to_owned(),
            role: Some(Role::Submitter),
            token_id: None,
            from: Some("10.0.0.5".to_owned()),
            action: AuditAction::JobCancelled,
            target: "film".to_owned(),
            project: Some("one, \"two\"".to_owned()),
            detail: None,
        };
        let text = as_csv(&[entry], true);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], COLUMNS.join(","));
        assert_eq!(
            lines[1],
            "7,1970-01-01T00:00:00.000000Z,'=cmd|' /C calc'!A0,submitter,,10.0.0.5,job_cancelled,\
             film,\"one, \"\"two\"\"\","
        );
    }
}
