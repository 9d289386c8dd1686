//! The data folder of a farm on this machine, as commands name it.

use forelight_store::DATABASE;
use forelight_terminal::failure::BadInput;
use std::io::ErrorKind;
use std::path::Path;

/// Checks that the folder that this flag names exists and can be read.
pub fn check(flag: &str, folder: &Path) -> Result<(), BadInput> {
    let wrong = |why: String| BadInput::new(format!("{flag} {}: {why}", folder.display()));
    match std::fs::metadata(folder) {
        Ok(about) if about.is_dir() => Ok(()),
        Ok(_) => Err(wrong("this is not a folder".to_owned()).hint(NAME_IT)),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Err(wrong("this folder does not exist".to_owned()).hint(NAME_IT))
        }
        Err(error) => Err(wrong(error.to_string())),
    }
}

/// Checks that the folder holds a farm.
pub fn check_farm(flag: &str, folder: &Path) -> Result<(), BadInput> {
    check(flag, folder)?;
    let wrong = |why: &str| BadInput::new(format!("{flag} {}: {why}", folder.display()));
    match std::fs::metadata(folder.join(DATABASE)) {
        Ok(about) if about.is_file() => Ok(()),
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(wrong(&error.to_string()).hint("run this command as the user that runs the farm"))
        }
        _ => Err(wrong("this folder does not contain a farm").hint(NAME_IT)),
    }
}

const NAME_IT: &str =
    "use the same --data folder as `forelight farm` or `forelight serve`; the first start of a farm makes it";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_holds_no_farm_is_told_from_one_that_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let said = |path: &Path| check_farm("--data", path).unwrap_err().to_string();
        assert!(said(folder.path()).ends_with("this folder does not contain a farm"));
        assert!(said(&folder.path().join("none")).ends_with("none: this folder does not exist"));
        std::fs::write(folder.path().join(DATABASE), "").unwrap();
        check_farm("--data", folder.path()).unwrap();
        assert!(said(&folder.path().join(DATABASE)).ends_with("this is not a folder"));
    }
}
