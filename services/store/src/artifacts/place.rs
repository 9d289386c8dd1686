//! Where artefacts are kept: in the data folder, or in an S3-compatible bucket.
//!
//! The command line gives only the bucket's name and a prefix, `s3://bucket/prefix`. Everything else comes
//! from the environment variables that every S3 tool reads: `AWS_ENDPOINT_URL` (any S3-compatible server),
//! `AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`, roles of containers and
//! machines, and `AWS_ALLOW_HTTP` for servers without TLS. Secrets are never read from the command line,
//! which other users of a machine can see, and never written anywhere.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};

use crate::error::{Result, StoreError};

/// Longest prefix, in bytes. A name adds 68 bytes, and S3 accepts names of up to 1024.
const LONGEST_PREFIX: usize = 512;

/// How the object store retries a request. Short, because clients retry as well.
const RETRIES: RetryConfig = RetryConfig {
    backoff: BackoffConfig {
        init_backoff: Duration::from_millis(100),
        max_backoff: Duration::from_secs(2),
        base: 2.0,
    },
    max_retries: 3,
    retry_timeout: Duration::from_secs(10),
};

/// Where artefacts are kept.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub enum ArtifactPlace {
    /// The folder `artifacts` of the data folder.
    #[default]
    DataFolder,
    /// An S3-compatible bucket.
    S3 {
        /// The bucket's name.
        bucket: String,
        /// The folder in the bucket, without slashes at its ends. May be empty.
        prefix: String,
    },
}

/// Why a text does not name a place.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadPlace(String);

impl fmt::Display for ArtifactPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DataFolder => f.write_str("data-folder"),
            Self::S3 { bucket, prefix } if prefix.is_empty() => write!(f, "s3://{bucket}"),
            Self::S3 { bucket, prefix } => write!(f, "s3://{bucket}/{prefix}"),
        }
    }
}

impl FromStr for ArtifactPlace {
    type Err = BadPlace;

    fn from_str(text: &str) -> Result<Self, BadPlace> {
        if text == "data-folder" {
            return Ok(Self::DataFolder);
        }
        let rest = text.strip_prefix("s3://").ok_or_else(|| {
            BadPlace("expected s3://BUCKET or s3://BUCKET/PREFIX, or data-folder".to_owned())
        })?;
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let of_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '.' | '_');
        if !(3..=63).contains(&bucket.len()) || !bucket.chars().all(of_name) {
            return Err(BadPlace(format!(
                "`{bucket}` is not the name of a bucket (3 to 63 of a-z, 0-9, - and .)"
            )));
        }
        let prefix = prefix.trim_end_matches('/');
        let of_prefix =
            |c: char| c.is_ascii_alphanumeric() || matches!(c, '/' | '-' | '_' | '.' | '=' | '+' | '@');
        let parts_hold = prefix.is_empty() || prefix.split('/').all(|part| !matches!(part, "" | "." | ".."));
        if !prefix.chars().all(of_prefix) || !parts_hold || prefix.len() > LONGEST_PREFIX {
            return Err(BadPlace(format!(
                "`{prefix}` is not a prefix: use names of a-z, A-Z, 0-9 and -_.=+@ between slashes, \
                 none of them empty, . or .."
            )));
        }
        Ok(Self::S3 { bucket: bucket.to_owned(), prefix: prefix.to_owned() })
    }
}

/// Opens the bucket. No request is sent yet.
pub(super) fn open_s3(bucket: &str) -> Result<Arc<dyn ObjectStore>> {
    let unusable = |reason: String| StoreError::ArtifactPlace(format!("the bucket {bucket}: {reason}"));
    let builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_retry(RETRIES)
        .with_client_options(client_options(std::env::var("AWS_ALLOW_HTTP").ok().as_deref()));
    let endpoint = [AmazonS3ConfigKey::S3Endpoint, AmazonS3ConfigKey::Endpoint]
        .iter()
        .find_map(|key| builder.get_config_value(key));
    if let Some(endpoint) = endpoint
        && endpoint.starts_with("http://")
        && !allows_http(std::env::var("AWS_ALLOW_HTTP").ok().as_deref())
    {
        return Err(unusable(format!(
            "its server {endpoint} uses no encryption; set AWS_ALLOW_HTTP=true to allow this"
        )));
    }
    let built = builder.build().map_err(|error| unusable(error.to_string()))?;
    Ok(Arc::new(built))
}

/// A transfer may take long, but a server that is silent for half a minute is gone.
fn client_options(allow_http: Option<&str>) -> ClientOptions {
    ClientOptions::new()
        .with_allow_http(allows_http(allow_http))
        .with_connect_timeout(Duration::from_secs(5))
        .with_timeout_disabled()
        .with_read_timeout(Duration::from_secs(30))
}

fn allows_http(variable: Option<&str>) -> bool {
    variable.is_some_and(|text| matches!(text.trim().to_ascii_lowercase().as_str(), "true" | "1" | "yes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_and_a_prefix_are_read_and_written_alike() {
        for text in ["s3://farm", "s3://farm/a", "s3://a.farm-7/shots/2026=x/b_c", "data-folder"] {
            assert_eq!(text.parse::<ArtifactPlace>().unwrap().to_string(), text);
        }
        assert_eq!("s3://farm/a/".parse::<ArtifactPlace>().unwrap().to_string(), "s3://farm/a");
    }

    #[test]
    fn what_leads_out_of_a_prefix_or_is_no_bucket_is_refused_by_name() {
        for (text, named) in [
            ("https://farm/a", "s3://BUCKET"),
            ("s3://", "``"),
            ("s3://UPPER/a", "`UPPER`"),
            ("s3://farm/../other", "`../other`"),
            ("s3://farm/a/./b", "`a/./b`"),
            ("s3://farm//b", "`/b`"),
            ("s3://farm/a?versionId=1", "`a?versionId=1`"),
            ("s3://farm/a%2e%2e", "`a%2e%2e`"),
        ] {
            let error = text.parse::<ArtifactPlace>().unwrap_err().to_string();
            assert!(error.contains(named), "{text}: {error}");
        }
    }

    #[test]
    fn http_is_allowed_only_by_the_word() {
        for (value, allowed) in
            [(None, false), (Some("false"), false), (Some(""), false), (Some("TRUE"), true)]
        {
            assert_eq!(allows_http(value), allowed, "{value:?}");
        }
    }
}
