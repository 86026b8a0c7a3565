; An underwater robot finds a pipeline and inspects it, and may have to recharge.
; Of each PDDL action, ?a is the ROSA action that is done: whether it is feasible is for the
; knowledge base to say, before the action starts and all the while it runs.
(define (domain suave_extended)
  (:requirements :strips :typing :durative-actions)

  (:types
    action       ; one object per ROSA action
    pipeline
    robot
  )

  (:predicates
    (action_feasible ?a - action)        ; set from the knowledge base
    (search_pipeline_action ?a - action) ; which object is which ROSA action
    (inspect_pipeline_action ?a - action)
    (recharge_action ?a - action)
    (pipeline_found ?p - pipeline)       ; sensed by the mission
    (pipeline_inspected ?p - pipeline)
    (recharged ?r - robot)
  )

  (:functions )

  (:durative-action search_pipeline
    :parameters (?a - action ?p - pipeline ?r - robot)
    :duration (= ?duration 60)
    :condition (and
      (over all (search_pipeline_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (pipeline_found ?p))
    )
  )

  (:durative-action inspect_pipeline
    :parameters (?a - action ?p - pipeline ?r - robot)
    :duration (= ?duration 60)
    :condition (and
      (at start (pipeline_found ?p))
      (over all (inspect_pipeline_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (pipeline_inspected ?p))
    )
  )

  ; Recharging is expected to make the other two feasible again. This serves planning only:
  ; when the action has ended, the knowledge base says what is feasible.
  (:durative-action recharge
    :parameters (?a ?a1 ?a2 - action ?r - robot)
    :duration (= ?duration 30)
    :condition (and
      (over all (recharge_action ?a))
      (over all (action_feasible ?a))
      (at start (search_pipeline_action ?a1))
      (at start (inspect_pipeline_action ?a2))
    )
    :effect (and
      (at end (recharged ?r))
      (at end (action_feasible ?a1))
      (at end (action_feasible ?a2))
    )
  )
)
