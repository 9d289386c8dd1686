//! People who sign in by OpenID Connect.
//!
//! A person's rights are those that his groups give him when he signs in. They are kept as a token whose
//! secret nobody knows, so everything that holds for tokens holds for people: they are listed, revoked and
//! audited, and a session ends with its token.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::{Role, Timestamp, TokenId};

use crate::actor::Actor;
use crate::columns::Json;
use crate::database::Store;
use crate::error::Result;
use crate::reach::highest;
use crate::sessions::{NewSession, begin};
use crate::tokens;
use crate::writing::run;

/// What a person may do.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Rights {
    /// The same in all projects.
    Everywhere(Role),
    /// A role in each of these projects. Those that do not exist give nothing until somebody makes them.
    In(BTreeMap<String, Role>),
}

/// A person as his provider knows him.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Person {
    /// The provider's address and the person's id there.
    pub subject: String,
    /// His name, for people. 1 to 200 characters.
    pub name: String,
    /// What his groups let him do.
    pub rights: Rights,
}

impl Store {
    /// Begins a session of a person. It replaces the sessions that he has, so that other groups hold at once.
    pub async fn sign_in_person(
        &self,
        person: &Person,
        from: Option<IpAddr>,
        lifetime: Duration,
        now: Timestamp,
    ) -> Result<NewSession> {
        let (role, projects) = match &person.rights {
            Rights::Everywhere(role) => (*role, None),
            Rights::In(projects) => (highest(projects), Some(projects)),
        };
        let (hash, id) = (tokens::hash(&tokens::random()), TokenId::new());
        let actor = Actor { name: person.name.clone(), role, token: Some(id), from };
        let mut write = self.write().await?.by(Some(Arc::new(actor)));
        run!(write, "DELETE FROM tokens WHERE subject = ?", person.subject);
        run!(
            write,
            "INSERT INTO tokens (hash, id, name, kind, role, projects, subject, created_at, expires_at) \
             VALUES (?, ?, ?, 'person', ?, ?, ?, ?, ?)",
            &hash[..],
            id.0,
            person.name,
            role.name(),
            projects.map(Json),
            person.subject,
            now.micros(),
            now.plus_micros(i64::try_from(lifetime.as_micros()).unwrap_or(i64::MAX)).micros()
        );
        let session = begin(&mut write, &hash, lifetime, now).await?;
        self.commit(write).await?;
        Ok(session)
    }
}
