//! A block of a run's shared memory: atomic words that all its processes read and write concurrently.

use std::fmt::Debug;
use std::ops::Deref;

use iceoryx2::prelude::{FileName, SemanticString, ZeroCopySend};
use iceoryx2_bb_posix::access_mode::AccessMode;
use iceoryx2_cal::dynamic_storage::posix_shared_memory::{Builder, Configuration, Storage};
use iceoryx2_cal::dynamic_storage::{DynamicStorage, DynamicStorageBuilder};
use iceoryx2_cal::named_concept::{NamedConceptBuilder, NamedConceptConfiguration};

/// Why a block cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("cannot be used: iceoryx2 says {0}")]
pub struct BlockError(String);

impl BlockError {
    fn new(reason: &dyn Debug) -> Self {
        Self(format!("{reason:?}"))
    }
}

/// One process's view of a block. No process owns the block: it is removed with the run's other shared memory.
#[derive(Debug)]
pub struct Block<T: Debug + Send + Sync + ZeroCopySend + 'static>(Storage<T>);

impl<T: Debug + Send + Sync + ZeroCopySend + 'static> Block<T> {
    fn builder<'a>(prefix: &str, name: &str) -> Result<Builder<'a, T>, BlockError> {
        let file_name = |text: &str| FileName::new(text.as_bytes()).map_err(|reason| BlockError::new(&reason));
        let config = Configuration::default().prefix(&file_name(prefix)?);
        Ok(Builder::new(&file_name(name)?).config(&config).has_ownership(false))
    }

    /// Creates the block of this name for the run with this shared-memory prefix. Call before any process opens it.
    ///
    /// # Errors
    /// [`BlockError`] if the system refuses.
    pub fn create(prefix: &str, name: &str, value: impl Fn() -> T) -> Result<(), BlockError> {
        let builder = Self::builder(prefix, name)?.initializer(|block, _| {
            block.write(value());
            true
        });
        builder.create().map(drop).map_err(|reason| BlockError::new(&reason))
    }

    /// Opens an existing block.
    ///
    /// # Errors
    /// [`BlockError`] if the block does not exist, or the system refuses.
    pub fn open(prefix: &str, name: &str) -> Result<Self, BlockError> {
        let storage = Self::builder(prefix, name)?.open(AccessMode::ReadWrite);
        storage.map(Self).map_err(|reason| BlockError::new(&reason))
    }
}

impl<T: Debug + Send + Sync + ZeroCopySend + 'static> Deref for Block<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.get()
    }
}
