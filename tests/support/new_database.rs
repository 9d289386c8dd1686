//! A database without rows, for tests that each begin with one. The module around names `DATABASE` and `Store`.

use tokio::sync::OnceCell;

use super::{DATABASE, Store};

/// The bytes of its file. Making the schema takes longer than most tests, so it is done once.
pub async fn new_database() -> &'static [u8] {
    static MADE: OnceCell<Vec<u8>> = OnceCell::const_new();
    MADE.get_or_init(async || {
        let folder = tempfile::tempdir().unwrap();
        Store::open(folder.path()).await.unwrap().close().await;
        std::fs::read(folder.path().join(DATABASE)).unwrap()
    })
    .await
}
