//! The service's REST API as typed calls.

use crate::backoff::Backoff;
use crate::server_events::{EventParser, ServerEvent};
use crate::transport::{ClientError, Payload, Request, Token, Transport};
use bytes::Bytes;
use forelight_protocol::{
    AccuracyDoc, AnswersDoc, ArtifactHash, ArtifactStored, Budget, BudgetForecast, BudgetForecastRequest,
    BudgetList, BudgetRequest, Bundle, ClaimRequest, Event, EventId, ForecastDoc, FramePage, FrameRow, Job,
    JobCheck, JobId, JobPage, JobRequest, JoinRequest, Lease, LeaseId, Money, Node, NodeChange, NodeId,
    NodePage, NodeRegistration, PageToken, PlanDifference, PlanId, PlanPage, PlanSummary, ProblemKind,
    ProjectList, ProjectRequest, ProjectShare, ReleaseRequest, RenewRequest, Renewal, ResultAnswer,
    ResultRequest, TaskId, TaskLog, Timestamp,
};
use reqwest::header::{HeaderName, HeaderValue, RETRY_AFTER};
use reqwest::{Method, StatusCode};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use uuid::Uuid;

/// A connection to the service, cheap to clone.
#[derive(Debug, Clone)]
pub struct Client {
    transport: Transport,
}

/// What came of asking for a task.
#[derive(Debug, Clone, PartialEq)]
pub enum Claimed {
    /// A task.
    Lease(Box<Lease>),
    /// There was none within the time that the request allowed for.
    Nothing,
    /// The node sleeps by its calendar: it is not to ask again before so much time has passed.
    Asleep(Duration),
}

impl Claimed {
    /// The lease, if there is one.
    pub fn lease(self) -> Option<Lease> {
        match self {
            Self::Lease(lease) => Some(*lease),
            Self::Nothing | Self::Asleep(_) => None,
        }
    }
}

/// The pictures that a frame may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FramePicture {
    /// Object and material ids in colour.
    Preview,
    /// Cost of each pixel in colour.
    CostMap,
    /// The image, for looking at.
    Png,
    /// The image, linear.
    Exr,
}

impl FramePicture {
    /// The last part of its address.
    pub const fn file_name(self) -> &'static str {
        match self {
            Self::Preview => "preview.png",
            Self::CostMap => "cost-map.png",
            Self::Png => "image.png",
            Self::Exr => "image.exr",
        }
    }
}

impl Client {
    /// A client of the service at `address` (`http://host:port`), patient enough for a person.
    pub fn new(address: &str, token: Option<Token>) -> Result<Self, ClientError> {
        Ok(Self { transport: Transport::new(address, token, Backoff::PATIENT)? })
    }

    /// The same connection with another patience.
    pub fn with_backoff(&self, backoff: Backoff) -> Self {
        Self { transport: self.transport.with_backoff(backoff) }
    }

    /// The address of the service.
    pub fn address(&self) -> &str {
        self.transport.base()
    }

    /// Whether the service is there and ready for work.
    pub async fn ready(&self) -> Result<(), ClientError> {
        self.transport.send(&Request::new(Method::GET, "/readyz")).await.map(drop)
    }

    // ---- bundles and jobs

    /// Uploads a zip file. The key makes sure that an upload which is repeated is one upload.
    pub async fn upload_bundle(&self, zip: &Path, key: Uuid) -> Result<Bundle, ClientError> {
        let request =
            Request::new(Method::POST, "/v1/bundles").payload(Payload::File(zip.into(), "application/zip"));
        self.transport.json(&with_key(request, key)).await
    }

    /// Submits a job.
    pub async fn submit(&self, job: &JobRequest, key: Uuid) -> Result<Job, ClientError> {
        self.transport.json(&with_key(json(Method::POST, "/v1/jobs", job), key)).await
    }

    /// What submitting a job would say; nothing is kept.
    pub async fn check(&self, job: &JobRequest) -> Result<JobCheck, ClientError> {
        self.transport.json(&json(Method::POST, "/v1/jobs/check", job)).await
    }

    /// One job.
    pub async fn job(&self, id: JobId) -> Result<Job, ClientError> {
        self.transport.json(&Request::new(Method::GET, format!("/v1/jobs/{id}"))).await
    }

    /// Cancels a job; to do so twice is to do so once.
    pub async fn cancel(&self, id: JobId) -> Result<Job, ClientError> {
        self.transport.json(&Request::new(Method::POST, format!("/v1/jobs/{id}/cancel"))).await
    }

    /// What is known of a job's plan, seen with another deadline or budget if one is given.
    pub async fn answers(
        &self,
        id: JobId,
        deadline: Option<Timestamp>,
        budget: Option<Money>,
    ) -> Result<AnswersDoc, ClientError> {
        let deadline = deadline.map(|deadline| format!("deadline={deadline}"));
        let budget = budget.map(|budget| format!("budget={}", budget.micro_units()));
        let query: Vec<String> = deadline.into_iter().chain(budget).collect();
        let path = format!("/v1/jobs/{id}/answers?{}", query.join("&"));
        // Others may be asked about first, and a large farm takes a while.
        self.transport.json(&Request::new(Method::GET, path).timeout(Some(Duration::from_secs(90)))).await
    }

    /// A job's price against its deadline, as SVG.
    pub async fn price_curve(&self, id: JobId) -> Result<Bytes, ClientError> {
        let request = Request::new(Method::GET, format!("/v1/jobs/{id}/price-curve.svg"));
        let response = self.transport.send(&request.timeout(Some(Duration::from_secs(90)))).await?;
        let url = response.url().to_string();
        response
            .bytes()
            .await
            .map_err(|source| ClientError::Unreachable { url, source: source.without_url() })
    }

    /// The newest plans.
    pub async fn newest_plans(&self) -> Result<Vec<PlanSummary>, ClientError> {
        let page: PlanPage = self.transport.json(&Request::new(Method::GET, "/v1/plans")).await?;
        Ok(page.items)
    }

    /// What a plan changed.
    pub async fn plan_difference(&self, plan: PlanId) -> Result<PlanDifference, ClientError> {
        self.transport.json(&Request::new(Method::GET, format!("/v1/plans/{plan}/difference"))).await
    }

    /// The shares of all projects.
    pub async fn projects(&self) -> Result<ProjectList, ClientError> {
        self.transport.json(&Request::new(Method::GET, "/v1/projects")).await
    }

    /// Sets a project's share.
    pub async fn set_share(&self, request: &ProjectRequest) -> Result<ProjectShare, ClientError> {
        self.transport.json(&json(Method::POST, "/v1/projects", request)).await
    }

    /// The newest jobs of exactly this name.
    pub async fn jobs_named(&self, name: &str) -> Result<Vec<Job>, ClientError> {
        self.newest_jobs(&[("name", name)], 50).await
    }

    /// The newest jobs to which these filters apply (`state`, `project`, `name`), at most so many, up to 200.
    pub async fn newest_jobs(&self, filters: &[(&str, &str)], most: u32) -> Result<Vec<Job>, ClientError> {
        let mut path = format!("/v1/jobs?page_size={most}");
        for (name, value) in filters {
            let value: String = value.bytes().map(|byte| format!("%{byte:02X}")).collect();
            path += &format!("&{name}={value}");
        }
        let page: JobPage = self.transport.json(&Request::new(Method::GET, path)).await?;
        Ok(page.items)
    }

    /// A job's quote.
    pub async fn forecast(&self, id: JobId) -> Result<ForecastDoc, ClientError> {
        self.transport.json(&Request::new(Method::GET, format!("/v1/jobs/{id}/forecast"))).await
    }

    /// The ladders of qualities in a job's quote.
    pub async fn accuracy(&self, id: JobId) -> Result<AccuracyDoc, ClientError> {
        self.transport.json(&Request::new(Method::GET, format!("/v1/jobs/{id}/accuracy"))).await
    }

    /// All frames of a job, ascending.
    pub async fn frames(&self, id: JobId) -> Result<Vec<FrameRow>, ClientError> {
        let pages = |page: FramePage| (page.items, page.next_page_token);
        self.all_pages(&format!("/v1/jobs/{id}/frames"), pages).await
    }

    /// All budgets and how they stand.
    pub async fn budgets(&self) -> Result<BudgetList, ClientError> {
        self.transport.json(&Request::new(Method::GET, "/v1/budgets")).await
    }

    /// Sets a project's budget.
    pub async fn set_budget(&self, budget: &BudgetRequest) -> Result<Budget, ClientError> {
        self.transport.json(&json(Method::POST, "/v1/budgets", budget)).await
    }

    /// What tonight and the nights after it will cost.
    pub async fn budget_forecast(
        &self,
        asked: &BudgetForecastRequest,
    ) -> Result<BudgetForecast, ClientError> {
        self.transport.json(&json(Method::POST, "/v1/budget-forecasts", asked)).await
    }

    /// One picture of one frame, into memory.
    pub async fn picture(&self, id: JobId, frame: u32, picture: FramePicture) -> Result<Bytes, ClientError> {
        let path = format!("/v1/jobs/{id}/frames/{frame}/{}", picture.file_name());
        self.bytes(&path).await
    }

    /// A job's events after `after`, as they happen, until the service closes the stream.
    pub async fn events(&self, id: JobId, after: Option<EventId>) -> Result<EventStream, ClientError> {
        let mut request = Request::new(Method::GET, format!("/v1/jobs/{id}/events")).timeout(None);
        if let Some(after) = after {
            request.headers.insert(HeaderName::from_static("last-event-id"), HeaderValue::from(after));
        }
        let response = self.transport.send(&request).await?;
        Ok(EventStream { response, parser: EventParser::default(), ready: Vec::new().into_iter() })
    }

    // ---- work

    /// Announces a node; one of the same name is updated and keeps its id.
    pub async fn register(&self, node: &NodeRegistration, key: Uuid) -> Result<Node, ClientError> {
        self.transport.json(&with_key(json(Method::POST, "/v1/nodes", node), key)).await
    }

    /// Joins the farm with a one-time token: this client's. Asking again with the same hash is harmless.
    pub async fn join(&self, request: &JoinRequest) -> Result<Node, ClientError> {
        self.transport.json(&json(Method::POST, "/v1/nodes/join", request)).await
    }

    /// All nodes, oldest first.
    pub async fn nodes(&self) -> Result<Vec<Node>, ClientError> {
        self.all_pages("/v1/nodes", |page: NodePage| (page.items, page.next_page_token)).await
    }

    /// The items of all pages of a list.
    async fn all_pages<P: DeserializeOwned, T>(
        &self,
        path: &str,
        parts: impl Fn(P) -> (Vec<T>, Option<PageToken>),
    ) -> Result<Vec<T>, ClientError> {
        let mut all = Vec::new();
        let mut page = format!("{path}?page_size=200");
        loop {
            let (items, next) = parts(self.transport.json(&Request::new(Method::GET, page)).await?);
            all.extend(items);
            match next {
                Some(token) => page = format!("{path}?page_size=200&page_token={token}"),
                None => return Ok(all),
            }
        }
    }

    /// Gives a node orders.
    pub async fn change_node(&self, node: NodeId, change: &NodeChange) -> Result<Node, ClientError> {
        self.transport.json(&json(Method::PATCH, format!("/v1/nodes/{node}"), change)).await
    }

    /// What the workers of a task had to say.
    pub async fn task_log(&self, task: TaskId) -> Result<TaskLog, ClientError> {
        self.transport.json(&Request::new(Method::GET, format!("/v1/tasks/{task}/log"))).await
    }

    /// Asks for a task. If an answer gets lost, asking again with the same key gives the same lease, instead of leaving it to run out.
    pub async fn claim(&self, claim: &ClaimRequest, key: Uuid) -> Result<Claimed, ClientError> {
        let patience = Duration::from_millis(u64::from(claim.wait_ms)) + Duration::from_secs(15);
        let request = with_key(json(Method::POST, "/v1/leases", claim).timeout(Some(patience)), key);
        let response = self.transport.send(&request).await?;
        if response.status() == StatusCode::NO_CONTENT {
            let after =
                response.headers().get(RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
            return Ok(
                after.map_or(Claimed::Nothing, |seconds| Claimed::Asleep(Duration::from_secs(seconds)))
            );
        }
        let (status, url) = (response.status(), response.url().to_string());
        let broken = |source: reqwest::Error| ClientError::Unreachable {
            url: url.clone(),
            source: source.without_url(),
        };
        let body = response.bytes().await.map_err(broken)?;
        match serde_json::from_slice(&body) {
            Ok(lease) => Ok(Claimed::Lease(lease)),
            Err(error) => Err(ClientError::Unexpected { url, status, excerpt: error.to_string() }),
        }
    }

    /// Holds on to a lease. One attempt takes no longer than `patience`.
    pub async fn renew(
        &self,
        lease: LeaseId,
        renewal: &RenewRequest,
        patience: Duration,
    ) -> Result<Renewal, ClientError> {
        let request = json(Method::PATCH, format!("/v1/leases/{lease}"), renewal).timeout(Some(patience));
        self.transport.json(&request).await
    }

    /// Keeps the tiles of a frame that are finished so far.
    pub async fn put_checkpoint(&self, lease: LeaseId, fence: u64, tiles: Bytes) -> Result<(), ClientError> {
        let path = format!("/v1/leases/{lease}/checkpoint?fence={fence}");
        self.transport.send(&Request::new(Method::PUT, path).payload(Payload::Bytes(tiles))).await.map(drop)
    }

    /// The tiles of a lease's frame that an earlier worker finished, if there are any.
    pub async fn checkpoint(&self, lease: LeaseId) -> Result<Option<Bytes>, ClientError> {
        match self.bytes(&format!("/v1/leases/{lease}/checkpoint")).await {
            Ok(tiles) => Ok(Some(tiles)),
            Err(error) if error.is(ProblemKind::NotFound) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Reports a task's end.
    pub async fn report(&self, lease: LeaseId, result: &ResultRequest) -> Result<ResultAnswer, ClientError> {
        self.transport.json(&json(Method::POST, format!("/v1/leases/{lease}/result"), result)).await
    }

    /// Gives a task back unfinished.
    pub async fn release(&self, lease: LeaseId, fence: u64) -> Result<(), ClientError> {
        let request = json(Method::POST, format!("/v1/leases/{lease}/release"), &ReleaseRequest { fence });
        self.transport.send(&request).await.map(drop)
    }

    // ---- artefacts

    /// Stores bytes under their hash, unless they are there already.
    pub async fn store(&self, content: Bytes) -> Result<ArtifactHash, ClientError> {
        let hash = ArtifactHash(*blake3::hash(&content).as_bytes());
        let request =
            Request::new(Method::PUT, format!("/v1/artifacts/{hash}")).payload(Payload::Bytes(content));
        let stored: ArtifactStored = self.transport.json(&request).await?;
        if stored.hash != hash {
            return Err(ClientError::Corrupt {
                what: format!("artefact {hash}"),
                received: stored.hash.to_string(),
            });
        }
        Ok(hash)
    }

    /// An artefact into memory, its hash verified; refused if it is longer than `most` bytes.
    pub async fn artifact(&self, hash: ArtifactHash, most: u64) -> Result<Bytes, ClientError> {
        let too_large = || ClientError::TooLarge { what: format!("artefact {hash}"), most };
        let request = Request::new(Method::GET, format!("/v1/artifacts/{hash}")).timeout(None);
        let mut response = self.transport.send(&request).await?;
        let announced = response.content_length().unwrap_or(0);
        if announced > most {
            return Err(too_large());
        }
        let mut content = Vec::with_capacity(usize::try_from(announced).unwrap_or(0));
        while let Some(chunk) = response.chunk().await.map_err(|source| self.cut_off(&request, source))? {
            if (content.len() + chunk.len()) as u64 > most {
                return Err(too_large());
            }
            content.extend_from_slice(&chunk);
        }
        verify(hash, *blake3::hash(&content).as_bytes())?;
        Ok(content.into())
    }

    fn cut_off(&self, request: &Request, source: reqwest::Error) -> ClientError {
        let url = format!("{}{}", self.transport.base(), request.path);
        ClientError::Unreachable { url, source: source.without_url() }
    }

    /// An artefact into a file, its hash verified while it streams.
    pub async fn artifact_to_file(&self, hash: ArtifactHash, path: &Path) -> Result<(), ClientError> {
        let failed = |source| ClientError::File { path: path.into(), source };
        let request = Request::new(Method::GET, format!("/v1/artifacts/{hash}")).timeout(None);
        let mut response = self.transport.send(&request).await?;
        let mut file = tokio::fs::File::create(path).await.map_err(failed)?;
        let mut hasher = blake3::Hasher::new();
        loop {
            let chunk = response.chunk().await.map_err(|source| self.cut_off(&request, source))?;
            let Some(chunk) = chunk else { break };
            hasher.update(&chunk);
            file.write_all(&chunk).await.map_err(failed)?;
        }
        file.sync_all().await.map_err(failed)?;
        verify(hash, *hasher.finalize().as_bytes())
    }

    async fn bytes(&self, path: &str) -> Result<Bytes, ClientError> {
        let request = Request::new(Method::GET, path).timeout(None);
        let response = self.transport.send(&request).await?;
        response.bytes().await.map_err(|source| self.cut_off(&request, source))
    }
}

/// An open stream of a job's events.
#[derive(Debug)]
pub struct EventStream {
    response: reqwest::Response,
    parser: EventParser,
    ready: std::vec::IntoIter<ServerEvent>,
}

impl EventStream {
    /// The next event; `None` when the stream ended, by the service or by a lost connection: ask for a new one after
    /// the last event seen. Events of a kind that this version does not know are left out.
    pub async fn next(&mut self) -> Option<Event> {
        loop {
            for event in self.ready.by_ref() {
                match serde_json::from_str(&event.data) {
                    Ok(event) => return Some(event),
                    Err(error) => tracing::debug!(%error, kind = event.kind, "an event of an unknown kind"),
                }
            }
            match self.response.chunk().await {
                Ok(Some(chunk)) => self.ready = self.parser.feed(&chunk).into_iter(),
                Ok(None) => return None,
                Err(error) => {
                    tracing::debug!(error = %error.without_url(), "the event stream broke");
                    return None;
                }
            }
        }
    }
}

fn json<T: Serialize>(method: Method, path: impl Into<String>, body: &T) -> Request {
    // The wire types hold no maps with keys that are not strings, and no other thing that JSON cannot say.
    let body = serde_json::to_vec(body).unwrap_or_default();
    Request::new(method, path).payload(Payload::Json(body.into()))
}

fn with_key(mut request: Request, key: Uuid) -> Request {
    let key = HeaderValue::from_str(&key.to_string());
    if let Ok(key) = key {
        request.headers.insert(HeaderName::from_static("idempotency-key"), key);
    }
    request
}

fn verify(expected: ArtifactHash, received: [u8; 32]) -> Result<(), ClientError> {
    if expected.0 == received {
        return Ok(());
    }
    let received = ArtifactHash(received).to_string();
    Err(ClientError::Corrupt { what: format!("artefact {expected}"), received })
}
