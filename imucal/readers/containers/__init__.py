"""Bytes -> messages: open files and divide them into chunks."""

from imucal.readers.containers.container import Batch, Bytes, Channel, Container, Loss, Task, gather

__all__ = ["Batch", "Bytes", "Channel", "Container", "Loss", "Task", "gather"]
