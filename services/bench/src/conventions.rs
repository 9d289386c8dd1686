//! Shared by several benches: the paper's image size, the ambient levels to try, names of files.

use forelight_terminal::options::QualityOptions;

/// Width and height of images in the paper's experiment, pixels.
pub const PAPER_SIZE: u32 = 256;

/// Numbers of ambient bounces to try: those listed, or that of the quality, or 0 and 1.
pub fn bounces_to_try(listed: &[u32], quality: &QualityOptions) -> Vec<u32> {
    match (listed, quality.ambient_bounces) {
        ([], Some(bounces)) => vec![bounces],
        ([], None) => vec![0, 1],
        _ => listed.to_vec(),
    }
}

/// File name for a bundle: its index, then its name in lower-case letters, digits and hyphens. The index
/// keeps names distinct.
pub fn slug(place: usize, name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    format!("{}-{}", place + 1, name.chars().take(40).map(plain).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    #[test]
    fn names_of_files_are_plain_and_never_the_same() {
        assert_eq!(slug(0, "A kitchen/../x"), "1-a-kitchen----x");
        assert_ne!(slug(0, "same"), slug(1, "same"));
    }

    #[test]
    fn the_levels_that_are_listed_are_tried_or_the_one_that_the_quality_has() {
        let quality = |flags: &[&str]| parsed::<QualityOptions>([&["bench"], flags].concat());
        assert_eq!(bounces_to_try(&[], &quality(&["--ambient-bounces", "2"])), [2]);
        assert_eq!(bounces_to_try(&[], &quality(&[])), [0, 1]);
        assert_eq!(bounces_to_try(&[1, 3], &quality(&[])), [1, 3]);
    }
}
