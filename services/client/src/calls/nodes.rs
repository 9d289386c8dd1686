//! Nodes and the logs of their tasks.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::Request;
use forelight_protocol::{
    JoinRequest, JoinToken, JoinTokenRequest, Node, NodeChange, NodeId, NodePage, NodeRegistration, TaskId,
    TaskLog,
};
use reqwest::Method;
use uuid::Uuid;

impl Client {
    /// Registers a node. A node with this name is updated, and keeps its id.
    pub async fn register(&self, node: &NodeRegistration, key: Uuid) -> Result<Node, ClientError> {
        let request = Request::json(Method::POST, "/v1/nodes", node).of_worker();
        self.transport.json(&request.with_key(key)).await
    }

    /// Joins the farm with this client's one-time token. It may be repeated with the same hash.
    pub async fn join(&self, request: &JoinRequest) -> Result<Node, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/nodes/join", request).of_worker()).await
    }

    /// A one-time token, with which one machine can join the farm. Repeated, it makes another one.
    pub async fn create_join_token(&self, request: &JoinTokenRequest) -> Result<JoinToken, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/join-tokens", request)).await
    }

    /// All nodes, oldest first.
    pub async fn nodes(&self) -> Result<Vec<Node>, ClientError> {
        self.all_pages("/v1/nodes", &[], |page: NodePage| (page.items, page.next_page_token)).await
    }

    /// Gives a node orders, or changes its speed, price, calendar or terms.
    pub async fn change_node(&self, node: NodeId, change: &NodeChange) -> Result<Node, ClientError> {
        self.transport.json(&Request::json(Method::PATCH, format!("/v1/nodes/{node}"), change)).await
    }

    /// Removes a node and its token. `cancel_task`: also while it holds a task, which is then taken away.
    pub async fn remove_node(&self, node: NodeId, cancel_task: bool) -> Result<(), ClientError> {
        let path = format!("/v1/nodes/{node}?cancel_task={cancel_task}");
        self.transport.send(&Request::new(Method::DELETE, path)).await.map(drop)
    }

    /// The log of a task: the lines of all its attempts.
    pub async fn task_log(&self, task: TaskId) -> Result<TaskLog, ClientError> {
        self.get(format!("/v1/tasks/{task}/log")).await
    }
}
