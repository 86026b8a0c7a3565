; An underwater robot finds a pipeline and inspects it.
; Of each PDDL action, ?a is the ROSA action that is done: whether it is feasible is for the
; knowledge base to say, before the action starts and all the while it runs.
(define (domain suave)
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
    (pipeline_found ?p - pipeline)       ; sensed by the mission
    (pipeline_inspected ?p - pipeline)
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
)
