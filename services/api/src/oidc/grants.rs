//! What the groups of a person let him do.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::Role;
use forelight_store::{ALL_PROJECTS, Rights};
use serde::Deserialize;
use serde_json::Value;

/// A studio's sign-in provider, as a configuration file describes it.
#[derive(Clone, PartialEq, Eq, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignInProvider {
    /// Its name on the page.
    #[serde(default = "default_name")]
    pub name: String,
    /// Its address, below which `.well-known/openid-configuration` is.
    pub issuer: String,
    /// The service's name at the provider.
    pub client_id: String,
    /// The secret for that name, if the provider gave one. It comes from a file of its own.
    #[serde(skip)]
    pub client_secret: Option<String>,
    /// What to ask the provider for, besides `openid`.
    #[serde(default = "default_scopes")]
    pub scopes: Vec<String>,
    /// The claim with the person's groups: a list of names, or one name.
    #[serde(default = "default_claim")]
    pub groups_claim: String,
    /// What groups may do.
    #[serde(default)]
    pub grants: Vec<Grant>,
}

/// What a group may do.
#[derive(Clone, PartialEq, Eq, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grant {
    /// Name of the group. `*` is everybody whom the provider knows.
    pub group: String,
    /// What its people may do.
    pub role: Role,
    /// In this project only. If absent, in all of them.
    pub project: Option<String>,
}

fn default_name() -> String {
    "single sign-on".to_owned()
}

fn default_scopes() -> Vec<String> {
    ["profile", "email", "groups"].map(str::to_owned).to_vec()
}

fn default_claim() -> String {
    "groups".to_owned()
}

/// The names in a claim.
fn groups(claim: Option<&Value>) -> BTreeSet<String> {
    match claim {
        Some(Value::String(name)) => BTreeSet::from([name.clone()]),
        Some(Value::Array(names)) => {
            names.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect()
        }
        _ => BTreeSet::new(),
    }
}

fn rank(role: Role) -> u8 {
    match role {
        Role::Worker => 0,
        Role::Viewer => 1,
        Role::Submitter => 2,
        Role::Operator => 3,
    }
}

impl SignInProvider {
    /// What is wrong with it, if anything.
    pub fn check(&self) -> Result<(), String> {
        for grant in &self.grants {
            if grant.role == Role::Worker {
                return Err(format!("group {:?}: people are not workers", grant.group));
            }
            if grant.project.is_some() && grant.role == Role::Operator {
                return Err(format!("group {:?}: operators are for the whole farm", grant.group));
            }
        }
        Ok(())
    }

    /// What a person may do whose claim about groups is this: the most that one of them allows. `None` if nothing.
    pub fn rights_of(&self, claim: Option<&Value>) -> Option<Rights> {
        self.rights(&groups(claim))
    }

    fn rights(&self, groups: &BTreeSet<String>) -> Option<Rights> {
        let held = |grant: &&Grant| grant.group == "*" || groups.contains(&grant.group);
        let (mut everywhere, mut projects) = (None::<Role>, BTreeMap::<String, Role>::new());
        for grant in self.grants.iter().filter(held) {
            match &grant.project {
                None => everywhere = Some(higher(everywhere, grant.role)),
                Some(project) => {
                    let role = higher(projects.get(project).copied(), grant.role);
                    projects.insert(project.clone(), role);
                }
            }
        }
        // What is no more than everywhere needs no word of its own.
        projects.retain(|_, role| everywhere.is_none_or(|everywhere| rank(*role) > rank(everywhere)));
        match everywhere {
            None if projects.is_empty() => None,
            Some(role) if projects.is_empty() => Some(Rights::Everywhere(role)),
            everywhere => {
                projects.extend(everywhere.map(|role| (ALL_PROJECTS.to_owned(), role)));
                Some(Rights::In(projects))
            }
        }
    }
}

fn higher(own: Option<Role>, other: Role) -> Role {
    own.filter(|own| rank(*own) >= rank(other)).unwrap_or(other)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provider(grants: &[(&str, Role, Option<&str>)]) -> SignInProvider {
        let grant = |&(group, role, project): &(&str, Role, Option<&str>)| Grant {
            group: group.to_owned(),
            role,
            project: project.map(str::to_owned),
        };
        SignInProvider {
            name: default_name(),
            issuer: "https://id.example".to_owned(),
            client_id: "forelight".to_owned(),
            client_secret: None,
            scopes: default_scopes(),
            groups_claim: default_claim(),
            grants: grants.iter().map(grant).collect(),
        }
    }

    #[test]
    fn the_most_that_a_group_allows_holds() {
        let provider = provider(&[
            ("wranglers", Role::Operator, None),
            ("film", Role::Viewer, Some("film")),
            ("film-leads", Role::Submitter, Some("film")),
            ("ads", Role::Submitter, Some("ads")),
            ("studio", Role::Viewer, None),
        ]);
        let rights =
            |groups: &[&str]| provider.rights(&groups.iter().map(|group| (*group).to_owned()).collect());
        let of = |projects: &[(&str, Role)]| {
            Some(Rights::In(projects.iter().map(|(name, role)| ((*name).to_owned(), *role)).collect()))
        };
        assert_eq!(rights(&[]), None);
        assert_eq!(rights(&["canteen"]), None);
        assert_eq!(rights(&["film"]), of(&[("film", Role::Viewer)]));
        assert_eq!(rights(&["film-leads", "film"]), of(&[("film", Role::Submitter)]));
        assert_eq!(rights(&["film", "ads"]), of(&[("film", Role::Viewer), ("ads", Role::Submitter)]));
        assert_eq!(rights(&["film", "wranglers"]), Some(Rights::Everywhere(Role::Operator)));
        assert_eq!(rights(&["studio", "film"]), Some(Rights::Everywhere(Role::Viewer)));
        assert_eq!(rights(&["studio", "ads"]), of(&[("*", Role::Viewer), ("ads", Role::Submitter)]));
        assert!(provider.check().is_ok());
    }

    #[test]
    fn groups_are_a_list_or_one_name() {
        let names = |value: Value| groups(Some(&value)).into_iter().collect::<Vec<_>>();
        assert_eq!(names(serde_json::json!(["b", "a", 7])), ["a", "b"]);
        assert_eq!(names(serde_json::json!("a")), ["a"]);
        assert!(names(serde_json::json!({"a": 1})).is_empty() && groups(None).is_empty());
    }

    #[test]
    fn roles_that_people_cannot_have_are_refused() {
        assert!(provider(&[("a", Role::Worker, None)]).check().is_err());
        assert!(provider(&[("a", Role::Operator, Some("film"))]).check().is_err());
    }
}
