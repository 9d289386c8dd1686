//! TLS: verified by clients, with certificates that are read again, and HTTP/2 for browsers.

use std::path::{Path, PathBuf};

use crate::support::{Farm, until};
use forelight_api::TlsFiles;
use forelight_client::{Backoff, Client, Token};
use forelight_protocol::{Role, Timestamp};
use forelight_store::tokens;
use reqwest::{Certificate, StatusCode, Version};

/// A studio's own authority.
struct Authority {
    issuer: rcgen::Issuer<'static, rcgen::KeyPair>,
    pem: String,
}

impl Authority {
    fn new() -> Self {
        let mut parameters = rcgen::CertificateParams::new(Vec::<String>::new()).unwrap();
        parameters.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let key = rcgen::KeyPair::generate().unwrap();
        let pem = parameters.self_signed(&key).unwrap().pem();
        Self { issuer: rcgen::Issuer::new(parameters, key), pem }
    }

    /// Writes a certificate for this machine, and its key.
    fn certify(&self, files: &TlsFiles) {
        let key = rcgen::KeyPair::generate().unwrap();
        let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
        let certificate =
            rcgen::CertificateParams::new(names).unwrap().signed_by(&key, &self.issuer).unwrap();
        std::fs::write(&files.certificate, certificate.pem()).unwrap();
        std::fs::write(&files.key, key.serialize_pem()).unwrap();
    }
}

fn files(folder: &Path) -> TlsFiles {
    let at = |name: &str| -> PathBuf { folder.join(name) };
    TlsFiles { certificate: at("farm.pem"), key: at("farm.key") }
}

fn browser(roots: &[&Authority]) -> reqwest::Client {
    let roots = roots.iter().map(|it| Certificate::from_pem(it.pem.as_bytes()).unwrap());
    // No connection is kept, so that each request sees the present certificate.
    let builder = reqwest::Client::builder().tls_certs_only(roots).no_proxy().pool_max_idle_per_host(0);
    builder.build().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_verify_the_service_and_a_renewed_certificate_is_served_without_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let (studio, renewed) = (Authority::new(), Authority::new());
    let tls = files(folder.path());
    studio.certify(&tls);
    let own = tls.clone();
    let farm = Farm::with(move |config| config.tls = Some(own)).await;
    let address = format!("https://{}", farm.service.local_addr());
    let token = tokens::create(farm.service.store(), Role::Viewer, "screen", Timestamp::now()).await.unwrap();
    let client = |roots: &Authority| {
        let client = Client::trusting(&address, Some(Token::new(&token)), roots.pem.as_bytes()).unwrap();
        client.with_backoff(Backoff { attempts: Some(1), ..Backoff::PATIENT })
    };
    assert_eq!(client(&studio).nodes().await.unwrap(), []);
    client(&renewed).nodes().await.unwrap_err();
    // Browsers take HTTP/2.
    let ready = format!("{address}/readyz");
    let answer = browser(&[&studio]).get(&ready).send().await.unwrap();
    assert_eq!((answer.status(), answer.version()), (StatusCode::OK, Version::HTTP_2));
    // Half of a renewal, and files that hold nothing, change nothing.
    std::fs::write(&tls.certificate, "nothing").unwrap();
    assert!(browser(&[&studio]).get(&ready).send().await.is_ok());
    renewed.certify(&tls);
    until("the new certificate is served", async || browser(&[&renewed]).get(&ready).send().await.is_ok())
        .await;
    assert!(browser(&[&studio]).get(&ready).send().await.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_with_tls_answers_nobody_without_it_but_its_own_machine() {
    let folder = tempfile::tempdir().unwrap();
    let (studio, tls) = (Authority::new(), files(folder.path()));
    studio.certify(&tls);
    let own = tls.clone();
    let farm = Farm::with(move |config| config.tls = Some(own)).await;
    let plain = format!("http://{}/readyz", farm.service.local_addr());
    assert!(browser(&[]).get(&plain).send().await.is_err());
    assert!(farm.service.home_addr().ip().is_loopback());
    let home = format!("http://{}/readyz", farm.service.home_addr());
    assert_eq!(browser(&[]).get(&home).send().await.unwrap().status(), StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_do_not_fit_together_are_named_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let tls = files(folder.path());
    let refused = async |tls: &TlsFiles| {
        let mut config = crate::support::config(folder.path());
        std::fs::create_dir_all(folder.path().join("scenes")).unwrap();
        config.tls = Some(tls.clone());
        forelight_api::Service::start(config).await.err().map(|error| error.to_string()).unwrap()
    };
    assert!(refused(&tls).await.contains("farm.pem"));
    Authority::new().certify(&tls);
    let other =
        TlsFiles { certificate: folder.path().join("other.pem"), key: folder.path().join("other.key") };
    Authority::new().certify(&other);
    let mixed = TlsFiles { key: other.key, ..tls };
    assert!(refused(&mixed).await.contains("do not fit together"));
}
