//! Signing in by OpenID Connect: the code flow with PKCE (OpenID Connect Core 1.0, RFC 7636).
//!
//! A browser is sent to the studio's provider with a random `state`, `nonce` and challenge, and comes back
//! with a code. The service exchanges the code for an ID token, verifies it, and looks which roles the
//! person's groups have. The hazards:
//!
//! - *Somebody is signed in as another person, by a link that this one began.* The browser that comes back
//!   must hold the cookie of the sign-in that it began.
//! - *A code is stolen or replayed.* Without the verifier it is worth nothing, and a sign-in is used up.
//! - *The provider is away.* People with tokens and sessions do not notice.

mod grants;

use std::collections::BTreeMap;
use std::time::Duration;

use forelight_protocol::Timestamp;
use forelight_store::Person;
use futures::future::BoxFuture;
use openidconnect::core::{
    CoreAuthDisplay, CoreAuthPrompt, CoreErrorResponseType, CoreGenderClaim, CoreJsonWebKey,
    CoreJweContentEncryptionAlgorithm, CoreJwsSigningAlgorithm, CoreProviderMetadata, CoreRevocableToken,
    CoreRevocationErrorResponse, CoreTokenIntrospectionResponse, CoreTokenType,
};
use openidconnect::{
    AdditionalClaims, AuthenticationFlow, AuthorizationCode, Client, ClientId, ClientSecret, CsrfToken,
    EmptyExtraTokenFields, EndpointMaybeSet, EndpointNotSet, EndpointSet, HttpRequest, HttpResponse,
    IdTokenFields, IssuerUrl, Nonce, PkceCodeChallenge, PkceCodeVerifier, RedirectUrl, Scope,
    StandardErrorResponse, StandardTokenResponse, TokenResponse as _,
};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub use self::grants::{Grant, SignInProvider};

/// Where the provider sends a browser back to.
pub(crate) const CALLBACK: &str = "/v1/sign-in/callback";

/// How long a person may take at the provider: ten minutes, in microseconds.
const PATIENCE: i64 = 600_000_000;

/// Most sign-ins under way. The oldest give way.
const MOST_UNDER_WAY: usize = 10_000;

/// Longest answer of a provider.
const LONGEST: Duration = Duration::from_secs(15);

/// How long the provider's description is believed, with its keys: an hour, in microseconds.
const DESCRIPTION_KEPT: i64 = 3_600_000_000;

/// All claims of an ID token besides the standard ones.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
struct OtherClaims(Map<String, Value>);

impl AdditionalClaims for OtherClaims {}

type Tokens = StandardTokenResponse<
    IdTokenFields<
        OtherClaims,
        EmptyExtraTokenFields,
        CoreGenderClaim,
        CoreJweContentEncryptionAlgorithm,
        CoreJwsSigningAlgorithm,
    >,
    CoreTokenType,
>;

type Provider = Client<
    OtherClaims,
    CoreAuthDisplay,
    CoreGenderClaim,
    CoreJweContentEncryptionAlgorithm,
    CoreJsonWebKey,
    CoreAuthPrompt,
    StandardErrorResponse<CoreErrorResponseType>,
    Tokens,
    CoreTokenIntrospectionResponse,
    CoreRevocableToken,
    CoreRevocationErrorResponse,
    EndpointSet,
    EndpointNotSet,
    EndpointNotSet,
    EndpointNotSet,
    EndpointMaybeSet,
    EndpointMaybeSet,
>;

/// Why somebody could not be signed in.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SignInError {
    /// The provider cannot be reached, or its answer is not understood.
    #[error("the sign-in provider {issuer} cannot be used now: {reason}")]
    Provider { issuer: String, reason: String },
    /// The browser did not begin this sign-in, or took too long.
    #[error("this sign-in was not begun by this browser, or took too long; begin again")]
    Unknown,
    /// The provider's answer does not prove who the person is.
    #[error("the provider's answer is refused: {0}")]
    Refused(String),
    /// None of the person's groups has a role.
    #[error("{0} is known, but is in no group with a role on this farm; ask an operator")]
    NoRole(String),
}

/// A sign-in that waits for its browser to come back.
struct UnderWay {
    nonce: Nonce,
    verifier: PkceCodeVerifier,
    begun: Timestamp,
}

/// Signs people in through a provider.
pub(crate) struct SignIn {
    config: SignInProvider,
    http: reqwest::Client,
    redirect: RedirectUrl,
    under_way: Mutex<BTreeMap<String, UnderWay>>,
    known: Mutex<Option<(Timestamp, CoreProviderMetadata)>>,
}

/// An error of a request to the provider.
#[derive(Debug, thiserror::Error)]
enum HttpError {
    #[error(transparent)]
    Request(#[from] reqwest::Error),
    #[error(transparent)]
    Answer(#[from] axum::http::Error),
}

impl SignIn {
    /// `origin` is where people reach the service, such as `https://farm.example.org`.
    pub fn new(config: SignInProvider, origin: &str) -> Result<Self, String> {
        let redirect = RedirectUrl::new(format!("{origin}{CALLBACK}")).map_err(|error| error.to_string())?;
        IssuerUrl::new(config.issuer.clone()).map_err(|error| format!("issuer: {error}"))?;
        let builder = reqwest::Client::builder().timeout(LONGEST).redirect(reqwest::redirect::Policy::none());
        let http = builder.build().map_err(|error| error.to_string())?;
        Ok(Self { config, http, redirect, under_way: Mutex::default(), known: Mutex::default() })
    }

    /// The provider's name for people.
    pub fn name(&self) -> &str {
        &self.config.name
    }

    /// Begins a sign-in: the address to send the browser to, and the state that it has to bring back.
    pub async fn begin(&self, now: Timestamp) -> Result<(String, String), SignInError> {
        let provider = self.provider(now).await?;
        let (challenge, verifier) = PkceCodeChallenge::new_random_sha256();
        let flow = AuthenticationFlow::<openidconnect::core::CoreResponseType>::AuthorizationCode;
        let mut request = provider.authorize_url(flow, CsrfToken::new_random, Nonce::new_random);
        for scope in &self.config.scopes {
            request = request.add_scope(Scope::new(scope.clone()));
        }
        let (address, state, nonce) = request.set_pkce_challenge(challenge).url();
        let state = state.into_secret();
        let mut under_way = self.under_way.lock();
        under_way.retain(|_, sign_in| now.micros_since(sign_in.begun) < PATIENCE);
        if under_way.len() >= MOST_UNDER_WAY
            && let Some(oldest) =
                under_way.iter().min_by_key(|(_, sign_in)| sign_in.begun).map(|(state, _)| state.clone())
        {
            under_way.remove(&oldest);
        }
        under_way.insert(state.clone(), UnderWay { nonce, verifier, begun: now });
        Ok((address.into(), state))
    }

    /// The person who came back with this code and state.
    pub async fn finish(&self, code: &str, state: &str, now: Timestamp) -> Result<Person, SignInError> {
        let sign_in = self.under_way.lock().remove(state).ok_or(SignInError::Unknown)?;
        if now.micros_since(sign_in.begun) >= PATIENCE {
            return Err(SignInError::Unknown);
        }
        let provider = self.provider(now).await?;
        let refused = |error: &dyn std::fmt::Display| SignInError::Refused(error.to_string());
        let http = self.http();
        let exchange = provider.exchange_code(AuthorizationCode::new(code.to_owned()));
        let exchange = exchange.map_err(|error| refused(&error))?.set_pkce_verifier(sign_in.verifier);
        let tokens: Tokens = exchange.request_async(&http).await.map_err(|error| refused(&error))?;
        let id_token = tokens.id_token().ok_or_else(|| refused(&"it has no ID token"))?;
        let claims = match id_token.claims(&provider.id_token_verifier(), &sign_in.nonce) {
            Ok(claims) => claims,
            Err(error) => {
                // The provider may have new keys, so its description is asked for again next time.
                *self.known.lock() = None;
                return Err(refused(&error));
            }
        };
        let subject = claims.subject().as_str();
        let name = claims
            .email()
            .map(|email| email.as_str())
            .or_else(|| claims.preferred_username().map(|name| name.as_str()))
            .unwrap_or(subject);
        let name: String = name.chars().filter(|letter| !letter.is_control()).take(200).collect();
        let groups = claims.additional_claims().0.get(&self.config.groups_claim);
        let rights = self.config.rights_of(groups).ok_or_else(|| SignInError::NoRole(name.clone()))?;
        Ok(Person { subject: format!("{} {subject}", self.config.issuer), name, rights })
    }

    async fn provider(&self, now: Timestamp) -> Result<Provider, SignInError> {
        let known = self.known.lock().clone();
        let metadata = match known {
            Some((at, metadata)) if now.micros_since(at) < DESCRIPTION_KEPT => metadata,
            _ => {
                let away =
                    |reason: String| SignInError::Provider { issuer: self.config.issuer.clone(), reason };
                let issuer = IssuerUrl::new(self.config.issuer.clone()).map_err(|e| away(e.to_string()))?;
                let http = self.http();
                let found = CoreProviderMetadata::discover_async(issuer, &http).await;
                let found = found.map_err(|error| away(error.to_string()))?;
                *self.known.lock() = Some((now, found.clone()));
                found
            }
        };
        let secret = self.config.client_secret.clone().map(ClientSecret::new);
        let client =
            Client::from_provider_metadata(metadata, ClientId::new(self.config.client_id.clone()), secret);
        Ok(client.set_redirect_uri(self.redirect.clone()))
    }

    /// Sends requests to the provider.
    fn http(
        &self,
    ) -> impl Fn(HttpRequest) -> BoxFuture<'static, Result<HttpResponse, HttpError>> + Send + Sync + use<>
    {
        let http = self.http.clone();
        move |request| Box::pin(send(http.clone(), request))
    }
}

async fn send(http: reqwest::Client, request: HttpRequest) -> Result<HttpResponse, HttpError> {
    let (head, body) = request.into_parts();
    let request = http.request(head.method, head.uri.to_string()).headers(head.headers).body(body);
    let answer = request.send().await?;
    let mut response = axum::http::Response::builder().status(answer.status());
    if let Some(headers) = response.headers_mut() {
        *headers = answer.headers().clone();
    }
    Ok(response.body(answer.bytes().await?.to_vec())?)
}
