//! The service's REST API as a client sees it: requests, retries, events.
