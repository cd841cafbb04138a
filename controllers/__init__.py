"""Laws that run every tick: state estimation, whole-body QP, joint servo, supervisor."""
