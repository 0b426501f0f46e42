"""What is shown: pages and pictures made from stored records alone."""
