; ROSA's way: a type `action` with one object for each ROSA action, a predicate for each kind of action.
(define (domain inspection)
    (:requirements
      :strips
      :typing
      :adl
      :negative-preconditions
      :durative-actions
    )

    (:types
      pipeline
      robot
      action
    )

    (:predicates
      (pipeline_found ?p - pipeline)
      (pipeline_inspected ?p - pipeline)
      (robot_started ?r - robot)

      (start_robot_action ?a - action)
      (search_pipeline_action ?a - action)
      (inspect_pipeline_action ?a - action)
      (recharge_action ?a - action)
      (action_feasible ?a - action)
    )

    (:functions

    )

    (:durative-action start_robot
      :parameters (?a - action ?r - robot)
      :duration ( = ?duration 5)
      :condition (and
        (at start (start_robot_action ?a))
        (at start (action_feasible ?a))
      )
      :effect (and
        (at end(robot_started ?r))
      )
    )

    (:durative-action search_pipeline
      :parameters (?a - action ?p - pipeline ?r - robot)
      :duration ( = ?duration 50)
      :condition (and
        (over all (robot_started ?r))
        (over all (search_pipeline_action ?a))
        (over all (action_feasible ?a))
      )
      :effect (and
        (at end(pipeline_found ?p))
      )
    )

    (:durative-action inspect_pipeline
      :parameters (?a - action ?p - pipeline ?r - robot)
      :duration ( = ?duration 80)
      :condition (and
        (over all (robot_started ?r))
        (over all (pipeline_found ?p))
        (over all (inspect_pipeline_action ?a))
        (over all (action_feasible ?a))
      )
      :effect (and
        (at end(pipeline_inspected ?p))
      )
    )

    (:durative-action recharge
      :parameters (?a ?a1 ?a2 - action ?r - robot)
      :duration ( = ?duration 5)
      :condition (and
        (over all (robot_started ?r))
        (over all (recharge_action ?a))
        (at start (search_pipeline_action ?a1))
        (at start (inspect_pipeline_action ?a2))
      )
      :effect (and
        (at end(action_feasible ?a1))
        (at end(action_feasible ?a2))
      )
    )
)
