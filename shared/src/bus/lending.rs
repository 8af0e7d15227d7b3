//! The iceoryx2 service of all topics: `ipc`, but that a message lent to be filled in takes nothing from the heap.
//!
//! iceoryx2 0.10 keeps a state of 32 bytes for each message that a publisher lends, from the loan until it is sent, and puts it on
//! the heap as it does the port's own (`ArcThreadSafetyPolicy`). [`Pooled`] is that policy for one thread, with blocks that are used again. What
//! lies in shared memory is the same as with `ipc`, so processes of either kind are on one bus.
//!
//! One of the two places with `unsafe` in the project: iceoryx2 lends values of any type and lifetime, which a pool cannot
//! hold by their type.

#![expect(unsafe_code, reason = "a pool for values of any type")]

use std::cell::{Cell, RefCell};
use std::fmt::Debug;
use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::ops::Deref;
use std::ptr::NonNull;

use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::service::{self, ipc};
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::arc_sync_policy::{ArcSyncPolicy, ArcSyncPolicyCreationError, LockGuard};

/// What every topic is made of.
#[derive(Debug, Clone)]
pub(super) struct Service;

impl service::Service for Service {
    type StaticStorage = <ipc::Service as service::Service>::StaticStorage;
    type ConfigSerializer = <ipc::Service as service::Service>::ConfigSerializer;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <ipc::Service as service::Service>::PersistentDynamicStorage<T>;
    type Bag = <ipc::Service as service::Service>::Bag;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <ipc::Service as service::Service>::DynamicStorage<T>;
    type ServiceNameHasher = <ipc::Service as service::Service>::ServiceNameHasher;
    type SharedMemory = <ipc::Service as service::Service>::SharedMemory;
    type ResizableSharedMemory = <ipc::Service as service::Service>::ResizableSharedMemory;
    type Connection = <ipc::Service as service::Service>::Connection;
    type Event = <ipc::Service as service::Service>::Event;
    type Monitoring = <ipc::Service as service::Service>::Monitoring;
    type Reactor = <ipc::Service as service::Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> = Pooled<T>;
    type BlackboardMgmt<KeyType: Send + Sync + Debug + ZeroCopySend + 'static> =
        <ipc::Service as service::Service>::BlackboardMgmt<KeyType>;
    type BlackboardPayload = <ipc::Service as service::Service>::BlackboardPayload;
    type UniqueId = <ipc::Service as service::Service>::UniqueId;
}

impl service::internal::ServiceInternal<Self> for Service {}

/// A value with several owners in one thread, as [`std::rc::Rc`] has it; small values lie in blocks that are used again.
pub(super) struct Pooled<T> {
    owned: NonNull<Owned<T>>,
    /// Dropping an owner may drop the value; and neither leaves its thread.
    _value: PhantomData<Owned<T>>,
}

struct Owned<T> {
    owners: Cell<usize>,
    value: T,
}

/// Room for a lent message's state and its count of owners.
type Block = MaybeUninit<[u128; 4]>;

thread_local! {
    #[expect(clippy::vec_box, reason = "a block stays where it is")]
    static FREE: RefCell<Vec<Box<Block>>> = const { RefCell::new(Vec::new()) };
}

impl<T> Pooled<T> {
    /// True if it lies in a block, false if in memory of its own: the same for all values of a type.
    const IN_BLOCK: bool = size_of::<Owned<T>>() <= size_of::<Block>() && align_of::<Owned<T>>() <= align_of::<Block>();

    fn of(value: T) -> Self {
        let room: *mut Owned<T> = if Self::IN_BLOCK {
            let free = FREE.try_with(|free| free.borrow_mut().pop()).ok().flatten();
            Box::into_raw(free.unwrap_or_else(|| Box::new(Block::uninit()))).cast()
        } else {
            Box::into_raw(Box::<Owned<T>>::new_uninit()).cast()
        };
        // SAFETY: `room` comes from a box, so it is not null, and nobody else has it. It is large and aligned enough: a block by
        // `IN_BLOCK`, or made for this type.
        let owned = unsafe {
            room.write(Owned { owners: Cell::new(1), value });
            NonNull::new_unchecked(room)
        };
        Self { owned, _value: PhantomData }
    }

    fn owned(&self) -> &Owned<T> {
        // SAFETY: the value lives while it has an owner, and `self` is one; only its last owner has it mutably.
        unsafe { self.owned.as_ref() }
    }
}

impl<T> Clone for Pooled<T> {
    fn clone(&self) -> Self {
        let owners = &self.owned().owners;
        owners.set(owners.get() + 1);
        Self { owned: self.owned, _value: PhantomData }
    }
}

impl<T> Drop for Pooled<T> {
    fn drop(&mut self) {
        let owners = &self.owned().owners;
        owners.set(owners.get() - 1);
        if owners.get() > 0 {
            return;
        }
        let room = self.owned.as_ptr();
        // SAFETY: this was the last owner, so the value is dropped once and not seen again.
        unsafe { room.drop_in_place() };
        if Self::IN_BLOCK {
            // SAFETY: it came from a box of a block, whose content need not be initialised.
            let block = unsafe { Box::from_raw(room.cast::<Block>()) };
            // When its thread ends the pool may be gone: then so is the block.
            let _ = FREE.try_with(|free| free.borrow_mut().push(block));
        } else {
            // SAFETY: it came from such a box, and its content need not be initialised.
            drop(unsafe { Box::from_raw(room.cast::<MaybeUninit<Owned<T>>>()) });
        }
    }
}

impl<T: Debug> Debug for Pooled<T> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.owned().value.fmt(formatter)
    }
}

impl<T: Abandonable> Abandonable for Pooled<T> {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: by the trait it is whole and not used again; that nobody has it at the same time is what every policy counts on.
        unsafe {
            let this = this.as_mut();
            if this.owned().owners.get() == 1 {
                T::abandon_in_place(NonNull::from_mut(&mut this.owned.as_mut().value));
            } else {
                std::ptr::drop_in_place(this);
            }
        }
    }
}

impl<T: Send + Debug + Abandonable> ArcSyncPolicy<T> for Pooled<T> {
    type LockGuard<'parent>
        = Guard<'parent, T>
    where
        Self: 'parent,
        T: 'parent;

    fn new(value: T) -> Result<Self, ArcSyncPolicyCreationError> {
        Ok(Self::of(value))
    }

    fn lock(&self) -> Self::LockGuard<'_> {
        Guard(&self.owned().value)
    }
}

/// A look at a [`Pooled`] value; there is one thread, so nothing is locked.
pub(super) struct Guard<'parent, T>(&'parent T);

impl<T> Deref for Guard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0
    }
}

impl<'parent, T: Send + Abandonable> LockGuard<'parent, T> for Guard<'parent, T> {}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use super::*;

    #[test]
    fn a_value_lives_as_long_as_its_last_owner() {
        fn check<T: Clone + PartialEq + Debug>(padding: T) {
            let witness = Rc::new(());
            let first = Pooled::of((Rc::clone(&witness), padding.clone()));
            let second = first.clone();
            drop(first);
            assert_eq!(second.owned().value.1, padding);
            assert_eq!(Rc::strong_count(&witness), 2);
            drop(second);
            assert_eq!(Rc::strong_count(&witness), 1);
        }
        check(7_u8);
        check([7_u64; 100]);
        const { assert!(Pooled::<u8>::IN_BLOCK && !Pooled::<[u64; 100]>::IN_BLOCK) }
    }

    #[test]
    fn a_free_block_serves_the_next_value_whatever_its_type() {
        let first = Pooled::of(1_u64);
        let block = first.owned.as_ptr() as usize;
        let beside = Pooled::of(2_u64);
        drop(first);
        let next = Pooled::of([3_u16; 5]);
        assert_eq!(next.owned.as_ptr() as usize, block);
        assert_ne!(beside.owned.as_ptr() as usize, block);
        assert_eq!((beside.owned().value, next.owned().value), (2, [3; 5]));
    }

    #[test]
    fn values_that_end_with_their_thread_are_freed() {
        thread_local! {
            static LATE: RefCell<Option<Pooled<Rc<()>>>> = const { RefCell::new(None) };
        }
        std::thread::spawn(|| {
            LATE.with(|late| *late.borrow_mut() = Some(Pooled::of(Rc::new(()))));
            drop(Pooled::of(1_u8));
        })
        .join()
        .unwrap();
    }
}
