"""From a plan to stored records: worker processes measure and time the cells."""
