//! What webhooks are told.

use forelight_protocol::{
    Event, EventKind, Job, JobId, JobState, Timestamp, WebhookData, WebhookKind, WebhookMessage,
};
use forelight_store::StoreError;
use serde_json::Value;

use crate::state::App;

/// What webhooks are told of an event; `None` if nothing.
pub(super) fn kind_of(event: &Event) -> Option<WebhookKind> {
    match (event.kind, event.job_state) {
        (EventKind::JobPromiseAtRisk, _) => Some(WebhookKind::PromiseAtRisk),
        (EventKind::JobPromiseSafe, _) => Some(WebhookKind::PromiseSafe),
        (EventKind::JobState, Some(JobState::Done)) => Some(WebhookKind::JobDone),
        (EventKind::JobState, Some(JobState::Failed)) => Some(WebhookKind::JobFailed),
        (EventKind::Budget, _) => Some(WebhookKind::Budget),
        (EventKind::NodeSetAside, _) => Some(WebhookKind::NodeSetAside),
        _ => None,
    }
}

/// What a message is about.
#[derive(Clone, Debug)]
pub(super) struct About {
    pub kind: WebhookKind,
    pub at: Timestamp,
    pub text: String,
    pub job_id: Option<JobId>,
    pub job: Option<String>,
    pub project: Option<String>,
    pub event: Option<Event>,
    pub url: Option<String>,
}

impl About {
    pub async fn event(app: &App, kind: WebhookKind, event: Event) -> Result<Self, StoreError> {
        let job = match event.job_id {
            Some(job) => Some(app.store.job(job).await?),
            None => None,
        };
        let place = match (event.job_id, event.node_id) {
            (Some(job), _) => format!("#/jobs/{job}"),
            (None, Some(node)) => format!("#/farm?node={node}"),
            (None, None) => String::new(),
        };
        Ok(Self {
            kind,
            at: event.at,
            text: text(kind, &event, job.as_ref()),
            job_id: event.job_id,
            url: app.public_origin.as_deref().map(|origin| format!("{origin}/{place}")),
            project: job.as_ref().map(|job| job.project.clone()).or_else(|| event.project.clone()),
            job: job.map(|job| job.name),
            event: Some(event),
        })
    }

    pub fn test(app: &App) -> Self {
        Self {
            kind: WebhookKind::Test,
            at: app.now(),
            text: "a test: this webhook of forelight works".to_owned(),
            job_id: None,
            job: None,
            project: None,
            event: None,
            url: app.public_origin.as_deref().map(|origin| format!("{origin}/")),
        }
    }

    /// The body: by the webhook's template, or a [`WebhookMessage`].
    pub fn body(&self, template: Option<&Value>) -> String {
        if let Some(template) = template {
            return self.filled(template).to_string();
        }
        let data = WebhookData {
            text: self.text.clone(),
            job_id: self.job_id,
            job: self.job.clone(),
            project: self.project.clone(),
            event: self.event.clone().map(Box::new),
            url: self.url.clone(),
        };
        // Strings, numbers and lists always have a JSON form.
        serde_json::to_string(&WebhookMessage { kind: self.kind, timestamp: self.at, data })
            .unwrap_or_default()
    }

    /// Replaces names in the strings of a template. What replaces them stays inside of its string.
    fn filled(&self, template: &Value) -> Value {
        match template {
            Value::String(text) => Value::String(self.replaced(text)),
            Value::Array(items) => items.iter().map(|item| self.filled(item)).collect(),
            Value::Object(fields) => {
                Value::Object(fields.iter().map(|(name, value)| (name.clone(), self.filled(value))).collect())
            }
            other => other.clone(),
        }
    }

    /// Replaces names in one pass, so that a name inside of a job's name is left as it is.
    fn replaced(&self, text: &str) -> String {
        let mut filled = String::new();
        let mut rest = text;
        while let Some(open) = rest.find('{') {
            let (before, from) = rest.split_at(open);
            filled += before;
            let name = from[1..].split_once('}').map(|(name, _)| name);
            match name.and_then(|name| Some((name, self.value(name)?))) {
                Some((name, value)) => {
                    filled += value;
                    rest = &from[name.len() + 2..];
                }
                None => {
                    filled.push('{');
                    rest = &from[1..];
                }
            }
        }
        filled + rest
    }

    fn value(&self, name: &str) -> Option<&str> {
        match name {
            "text" => Some(&self.text),
            "kind" => Some(self.kind.name()),
            "job" => Some(self.job.as_deref().unwrap_or_default()),
            "project" => Some(self.project.as_deref().unwrap_or_default()),
            "url" => Some(self.url.as_deref().unwrap_or_default()),
            _ => None,
        }
    }
}

fn text(kind: WebhookKind, event: &Event, job: Option<&Job>) -> String {
    let said = event.message.as_deref().unwrap_or_default();
    let name = job.map(|job| format!("{} of project {}", job.name, job.project)).unwrap_or_default();
    match kind {
        WebhookKind::PromiseAtRisk => format!("{name} is at risk: {said}"),
        WebhookKind::PromiseSafe => format!("{name} is safe: {said}"),
        WebhookKind::JobDone => {
            let frames = job.map(|job| format!(": {} of {} frames", job.frames_done, job.frames_total));
            format!("{name} is done{}", frames.unwrap_or_default())
        }
        WebhookKind::JobFailed => format!("{name} failed: {said}"),
        WebhookKind::Budget => format!("budget of project {said}"),
        WebhookKind::NodeSetAside => format!("node {said}"),
        WebhookKind::Test => said.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_template_is_filled_in_its_strings_and_nothing_breaks_out_of_them() {
        let about = About {
            kind: WebhookKind::JobFailed,
            at: Timestamp::from_micros(0),
            text: "a \"quoted\" text".to_owned(),
            job_id: None,
            job: Some("{url}\",\"admin\":\"true".to_owned()),
            project: None,
            event: None,
            url: Some("https://farm".to_owned()),
        };
        let template =
            json!({"text": "{text} {nothing} {", "blocks": [{"{kind}": "{job}|{project}|{kind}"}], "n": 7});
        let body: Value = serde_json::from_str(&about.body(Some(&template))).unwrap();
        assert_eq!(
            body,
            json!({"text": "a \"quoted\" text {nothing} {", "blocks": [{"{kind}": "{url}\",\"admin\":\"true||job_failed"}], "n": 7})
        );
        let plain: WebhookMessage = serde_json::from_str(&about.body(None)).unwrap();
        assert_eq!((plain.kind, plain.data.text), (WebhookKind::JobFailed, about.text));
    }
}
