mod by_hand;
mod on_archive;
mod properties;
