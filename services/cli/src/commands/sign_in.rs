//! The file that describes a studio's sign-in provider.

use anyhow::{Context, Result};
use forelight_api::SignInProvider;
use forelight_terminal::failure::BadInput;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The file: a provider, and where its secret is.
#[derive(Deserialize)]
struct File {
    /// File with the client's secret. A path is relative to this file.
    client_secret_file: Option<PathBuf>,
    #[serde(flatten)]
    provider: toml::Table,
}

/// Reads the file. Errors name it, and the place in it.
pub fn read(path: &Path) -> Result<SignInProvider> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    parse(&text, path)
        .map_err(|error| BadInput::new(format!("--sign-in {}: {error:#}", path.display())).into())
}

fn parse(text: &str, path: &Path) -> Result<SignInProvider> {
    let File { client_secret_file, provider } = toml::from_str(text)?;
    let mut provider: SignInProvider = toml::Value::Table(provider).try_into()?;
    if let Some(secret) = client_secret_file {
        let secret = path.parent().map_or(secret.clone(), |folder| folder.join(&secret));
        let text = std::fs::read_to_string(&secret)
            .with_context(|| format!("cannot read client_secret_file {}", secret.display()))?;
        provider.client_secret = Some(text.trim().to_owned());
    }
    Ok(provider)
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::Role;

    #[test]
    fn a_provider_is_read_with_its_secret_and_a_misspelt_key_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("secret"), "s3cret\n").unwrap();
        let file = folder.path().join("sign-in.toml");
        let text = "issuer = \"https://id.example\"\nclient_id = \"forelight\"\nclient_secret_file = \"secret\"\n\
                    [[grants]]\ngroup = \"film\"\nrole = \"submitter\"\nproject = \"film\"\n";
        std::fs::write(&file, text).unwrap();
        let provider = read(&file).unwrap();
        assert_eq!(provider.client_secret.as_deref(), Some("s3cret"));
        assert_eq!((provider.groups_claim.as_str(), provider.grants[0].role), ("groups", Role::Submitter));
        for wrong in
            ["issuer = 3", &text.replace("group =", "grupp ="), &text.replace("client_id", "klient_id")]
        {
            std::fs::write(&file, wrong).unwrap();
            assert!(read(&file).unwrap_err().to_string().contains("sign-in.toml"), "{wrong}");
        }
    }
}
