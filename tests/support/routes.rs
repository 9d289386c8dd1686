//! Bodies of all requests that change something, sent to a service with real things in place. Whatever they say,
//! the service refuses it in one line of words or does it, and never fails.

use crate::parsers::Parser;
use forelight_api::{Config, Service};
use forelight_protocol::{Problem, Role, Timestamp};
use forelight_store::tokens;
use reqwest::Method;
use reqwest::header::CONTENT_TYPE;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::OnceLock;
use tokio::runtime::Runtime;

/// The first two bytes choose the route, the rest is the body.
pub(crate) const ROUTES: Parser = Parser { name: "routes", read: routes, seeds };

/// An address of the service that takes a body.
struct Route {
    method: Method,
    path: String,
    media_type: String,
}

struct Farm {
    runtime: Runtime,
    http: reqwest::Client,
    address: String,
    operator: String,
    routes: Vec<Route>,
    /// What can stand in place of the ids in seeds.
    ids: BTreeMap<&'static str, String>,
    _service: Service,
    _folder: tempfile::TempDir,
}

/// Sends the body to a route.
pub fn routes(bytes: &[u8]) {
    let Some((number, body)) = bytes.split_first_chunk::<2>() else { return };
    let farm = farm();
    let route = &farm.routes[usize::from(u16::from_le_bytes(*number)) % farm.routes.len()];
    let Some(body) = harmless(body) else { return };
    let (status, answer) = farm.ask(route, body);
    let said = String::from_utf8_lossy(&answer);
    let place = format!("{} {} answers {status}: {said}", route.method, route.path);
    // The disk of this machine may be full.
    assert!(status < 500 || status == 507, "{place}");
    if status >= 400 {
        let problem: Problem = serde_json::from_slice(&answer).unwrap_or_else(|_| panic!("{place}"));
        assert!(problem.known_kind().is_some() && !problem.detail.is_empty(), "{place}");
        assert!(!problem.detail.contains('\n'), "{place}");
    }
}

/// The body so that no claim waits and no webhook is sent to others. `None` if it would be.
fn harmless(body: &[u8]) -> Option<Vec<u8>> {
    let Ok(mut value) = serde_json::from_slice::<Value>(body) else { return Some(body.to_vec()) };
    if let Some(wait) = value.get_mut("wait_ms").filter(|wait| wait.is_u64()) {
        *wait = json!(0);
        return Some(value.to_string().into_bytes());
    }
    let is_foreign = |url: &Value| url.as_str().is_some_and(|url| !url.starts_with("http://127.0.0.1:9/"));
    (!value.get("url").is_some_and(is_foreign)).then(|| body.to_vec())
}

fn farm() -> &'static Farm {
    static FARM: OnceLock<Farm> = OnceLock::new();
    FARM.get_or_init(Farm::start)
}

impl Farm {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let runtime = Runtime::new().expect("threads can be started");
        let scene = folder.path().join("scenes/quad");
        write_scene(&scene);
        let mut config = Config::new(folder.path().join("data"));
        config.listen = SocketAddr::from(([127, 0, 0, 1], 0));
        config.bundle_roots = vec![folder.path().join("scenes")];
        let service = runtime.block_on(Service::start(config)).expect("the service starts");
        let address = format!("http://{}", service.local_addr());
        let made = tokens::create(service.store(), Role::Operator, "operator", Timestamp::now());
        let operator = runtime.block_on(made).expect("a token can be made");
        let http =
            reqwest::Client::builder().no_proxy().tls_certs_only([]).build().expect("a client can be made");
        let (routes, ids) = (Vec::new(), BTreeMap::new());
        let mut farm =
            Self { runtime, http, address, operator, routes, ids, _service: service, _folder: folder };
        farm.ids = farm.things(&scene);
        farm.routes = farm.all_routes();
        farm
    }

    /// Makes a node, a job, a lease, a token and a webhook.
    fn things(&self, scene: &Path) -> BTreeMap<&'static str, String> {
        let post = |path: &str, body: Value| -> Value {
            let route = Route { method: Method::POST, path: path.to_owned(), media_type: JSON.to_owned() };
            let (status, answer) = self.ask(&route, body.to_string().into_bytes());
            assert!(status < 300, "{path}: {}", String::from_utf8_lossy(&answer));
            serde_json::from_slice(&answer).expect("a document")
        };
        let node = post("/v1/nodes", json!({"name": "a", "cores": 2}));
        let job = post("/v1/jobs", json!({"name": "a job", "bundle": {"path": scene}, "frames": "0-3"}));
        let lease = post("/v1/leases", json!({"node_id": node["id"], "wait_ms": 10_000}));
        let token = post("/v1/tokens", json!({"name": "guest", "role": "viewer"}));
        let webhook = post("/v1/webhooks", json!({"url": "http://127.0.0.1:9/"}));
        let text = |value: &Value| value.as_str().expect("an id").to_owned();
        BTreeMap::from([
            ("nodes", text(&node["id"])),
            ("jobs", text(&job["id"])),
            ("leases", text(&lease["lease_id"])),
            ("tokens", text(&token["token"]["id"])),
            ("webhooks", text(&webhook["id"])),
            ("scene", scene.display().to_string()),
        ])
    }

    /// Every operation of the service's own document that takes a body, in the order of the document.
    fn all_routes(&self) -> Vec<Route> {
        let document = forelight_api::openapi_yaml();
        let (mut path, mut method, mut has_body) = (String::new(), Method::GET, false);
        let mut routes = Vec::new();
        for line in document.lines() {
            let depth = line.len() - line.trim_start().len();
            let Some(key) = line.trim().strip_suffix(':') else { continue };
            match depth {
                2 if key.starts_with('/') => path = self.with_ids(key),
                4 => (method, has_body) = (key.to_uppercase().parse().unwrap_or(Method::GET), false),
                6 => has_body = key == "requestBody",
                10 if has_body => {
                    let (method, path) = (method.clone(), path.clone());
                    routes.push(Route { method, path, media_type: key.to_owned() });
                }
                _ => {}
            }
        }
        assert!(routes.len() > 25, "the document has {} bodies", routes.len());
        routes
    }

    /// An address with real ids.
    fn with_ids(&self, path: &str) -> String {
        let kind = path.split('/').nth(2).unwrap_or_default();
        let id = self.ids.get(kind).map_or("0198c0de-0000-7000-8000-000000000000", String::as_str);
        let path = path.replace("{id}", id).replace("{blake3}", &"0".repeat(64)).replace("{frame}", "0");
        if path.ends_with("/checkpoint") { path + "?fence=1" } else { path }
    }

    fn ask(&self, route: &Route, body: Vec<u8>) -> (u16, Vec<u8>) {
        let request = self.http.request(route.method.clone(), format!("{}{}", self.address, route.path));
        let request = request.bearer_auth(&self.operator).header(CONTENT_TYPE, &route.media_type).body(body);
        self.runtime.block_on(async {
            let answer = request.send().await.expect("the service answers");
            let status = answer.status().as_u16();
            (status, answer.bytes().await.expect("the answer is whole").to_vec())
        })
    }
}

const JSON: &str = "application/json";

/// A quad of 8 × 8 pixels, 20 frames.
fn write_scene(folder: &Path) {
    std::fs::create_dir_all(folder).expect("a temporary folder can be made");
    let scene = r#"{"version":1,"name":"q","geometry":["q.obj"],"camera":{"origin":[0,0,3],"target":[0,0,0],"up":[0,1,0],"fov_deg":40,"fov_axis":"x","width":8,"height":8},"environment":{"type":"constant","radiance":[1,1,1]},"animation":{"fps":24,"frames":20,"tracks":[]}}"#;
    let geometry = "mtllib q.mtl\no q\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nusemtl p\nf 1 2 3\n";
    for (name, content) in
        [("scene.json", scene), ("q.obj", geometry), ("q.mtl", "newmtl p\nKd 0.5 0.5 0.5\n")]
    {
        std::fs::write(folder.join(name), content).expect("a temporary file can be written");
    }
}

/// A good body, or an empty object, for every route.
fn seeds() -> Vec<Vec<u8>> {
    let farm = farm();
    let (job, node) = (&farm.ids["jobs"], &farm.ids["nodes"]);
    let body = |route: &Route| -> Value {
        let last = route.path.split(['/', '?']).rfind(|part| !part.is_empty()).unwrap_or_default();
        match (last, route.method.as_str()) {
            ("jobs" | "check", _) => {
                json!({"name": "b", "bundle": {"path": farm.ids["scene"]}, "frames": "0,2-3",
                "settings": {"width": 8, "height": 8, "spp": 1}, "deadline": "2030-01-01T00:00:00Z", "budget": 1_000_000,
                "confidence": "p80", "limits": {"wall_ms": 1000}, "division": "auto"})
            }
            ("nodes", _) => json!({"name": "b", "speed": 2.0, "cores": 2, "price_per_hour": 5,
                "capabilities": {"memory_bytes": 1, "renderers": [{"name": "cycles", "version": "5.0.1"}]},
                "schedule": {"zone": "UTC", "windows": [{"days": ["monday"], "from": "20:00", "until": "08:00"}]}}),
            ("join", _) => json!({"node": {"name": "c"}, "token_hash": "0".repeat(64)}),
            ("join-tokens", _) => json!({"name": "c", "valid_hours": 2}),
            ("leases", _) => json!({"node_id": node, "wait_ms": 0}),
            ("release", _) => json!({"fence": 99}),
            ("result", _) => json!({"fence": 1, "error": {"message": "no", "permanent": false}, "log": []}),
            ("retry" | "cancel", _) => json!({"frames": "0"}),
            ("leave-out", _) => json!({"reason": "a reason"}),
            ("what-if", _) => json!({"job_id": job, "change": {"more_nodes": {"node_id": node, "count": 1}}}),
            ("budgets", _) => {
                json!({"project": "default", "period": "month", "amount": 1_000_000, "zone": "UTC",
                "thresholds": [{"percent": 80, "action": "drain"}]})
            }
            ("budget-forecasts", _) => json!({"days": 2, "zone": "Europe/Berlin", "date": "2030-01-01"}),
            ("projects", _) => json!({"project": "film", "share": 2}),
            ("quotas", _) => {
                json!({"project": "film", "storage_bytes": 1_000_000_000, "open_jobs": 1_000_000})
            }
            ("retention", _) => json!({"project": "film", "kind": "images", "days": 30}),
            ("prune", _) => json!({"dry_run": true}),
            ("webhooks", _) => json!({"url": "http://127.0.0.1:9/", "events": ["job_state"]}),
            ("tokens", _) => {
                json!({"name": "d", "projects": {"default": "viewer"}, "expires_at": "2030-01-01T00:00:00Z"})
            }
            ("rotate", _) => json!({"grace_seconds": 600}),
            ("sessions", _) => json!({"code": "none"}),
            (id, "PATCH") if *id == farm.ids["leases"] => json!({"fence": 1, "progress": 0.5,
                "pixels": {"done": 1, "all": 64, "work": 10, "cpu_nanos": 10}, "log": []}),
            (id, "PATCH") if *id == farm.ids["nodes"] => json!({"price_per_hour": 5, "schedule": null,
                "terms": {"setup_seconds": 3, "maintenance": [{"start": "2030-01-01T00:00:00Z", "end": null}]}}),
            (id, "PATCH") if *id == farm.ids["jobs"] => {
                json!({"deadline": "2030-01-01T00:00:00Z", "budget": null})
            }
            (id, "PATCH") if *id == farm.ids["tokens"] => json!({"name": "guest 2"}),
            _ => json!({}),
        }
    };
    let seed = |(number, route): (usize, &Route)| {
        let number = u16::try_from(number).unwrap_or_default().to_le_bytes();
        [&number[..], body(route).to_string().as_bytes()].concat()
    };
    farm.routes.iter().enumerate().map(seed).collect()
}
