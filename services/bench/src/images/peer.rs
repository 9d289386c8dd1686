//! Images of the same scene by other programs.

use std::path::PathBuf;
use std::str::FromStr;

/// An image, its cost and its reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    pub name: String,
    pub image: PathBuf,
    /// CPU time of rendering, seconds.
    pub cpu_seconds: f64,
    /// The program's own converged image, if its light transport differs from ours.
    pub reference: Option<PathBuf>,
}

impl FromStr for Peer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}`: expected NAME:IMAGE.exr:CPU_SECONDS or NAME:IMAGE.exr:CPU_SECONDS:REFERENCE.exr"
            )
        };
        let parts: Vec<&str> = text.split(':').collect();
        let (name, image, seconds, reference) = match parts[..] {
            [name, image, seconds] => (name, image, seconds, None),
            [name, image, seconds, reference] => (name, image, seconds, Some(reference.into())),
            _ => return Err(wrong()),
        };
        let cpu_seconds =
            seconds.parse().ok().filter(|s: &f64| s.is_finite() && *s > 0.0).ok_or_else(wrong)?;
        Ok(Self { name: name.into(), image: image.into(), cpu_seconds, reference })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_has_a_name_an_image_and_its_time_and_perhaps_a_reference() {
        let peer: Peer = "rpict aa .1:a/b.exr:12.5".parse().unwrap();
        assert_eq!((peer.name.as_str(), peer.cpu_seconds, peer.reference), ("rpict aa .1", 12.5, None));
        let peer: Peer = "m:a.exr:1:ref.exr".parse().unwrap();
        assert_eq!(peer.reference, Some("ref.exr".into()));
        for text in ["m:a.exr", "m:a.exr:fast", "m:a.exr:-1", "a:b:c:d:e"] {
            assert!(text.parse::<Peer>().unwrap_err().contains("CPU_SECONDS"), "{text}");
        }
    }
}
